"""The unit cell traced by Mitsuba 3: a particle loop of the same physics, and Mitsuba's own `path` integrator.

Started by `benchmarks/mitsuba_cell.py` as a process of its own: an unsuitable libLLVM aborts the process instead of
raising. It imports Mitsuba and the standard library alone, so it also runs in an environment without luxloop. One
JSON object on the command line says what to trace; one JSON object is printed.

        z = D  ─────────────────  receiver: counts what arrives, sends 35 % back as Lambertian
                     ┌────┐
        z = 0  ──────┴────┴─────  substrate: 97 % into the Gaussian lobe, also below the chip
               -S/2    0    +S/2  periodic: particles are wrapped; `path` sees mirrors, the same by symmetry
"""

# mypy: ignore-errors
# (the arrays of Dr.Jit overload every operator; its stubs do not follow them through @dr.syntax)

from __future__ import annotations

import json
import math
import sys
import time
from typing import Any

import drjit as dr
import mitsuba as mi

mi.set_variant("llvm_ad_mono")

OFF_UM = 1e-3  # a ray starts this far off the face it leaves: 60 times the spacing of float32 at 250 um
ROULETTE_BELOW = 0.1  # a particle below this weight goes on with this weight, or ends
LEDGER = ("segments", "lost", "truncated")
NULL = {"type": "null"}


def quad(centre: list[float], normal: list[float], half_u: float, half_v: float, **more: Any) -> dict[str, Any]:
    """A rectangle of 2 half_u x 2 half_v (um) about `centre` that faces along `normal`; v is z where it can be."""
    up = [0.0, 1.0, 0.0] if normal[2] else [0.0, 0.0, 1.0]
    target = [c + n for c, n in zip(centre, normal, strict=True)]
    to_world = mi.ScalarTransform4f().look_at(origin=centre, target=target, up=up)
    return {"type": "rectangle", "to_world": to_world.scale([half_u, half_v, 1.0]), **more}


def sides(half: float, centre_z: float, half_z: float, outwards: int, **more: Any) -> dict[str, Any]:
    """The four walls x, y = +-half (um), facing outwards (+1) or inwards (-1)."""
    return {
        f"wall {x} {y}": quad([x * half, y * half, centre_z], [outwards * x, outwards * y, 0], half, half_z, **more)
        for x, y in ((1, 0), (-1, 0), (0, 1), (0, -1))
    }


class Cell:
    """The cell's sizes in um, its surfaces, and the bins of its receiver, from the request."""

    def __init__(self, asked: dict[str, Any]) -> None:
        self.D, self.W, self.S, self.T = (asked[f"{name}_um"] for name in "DWST")
        self.n_gan, self.sigma_rad = asked["n_gan"], math.radians(asked["sigma_deg"])
        self.substrate, self.receiver = asked["substrate_reflectance"], asked["receiver_reflectance"]
        self.bins = asked["bins"]

    def scene(self, chip: dict, substrate: dict, receiver: dict, top: dict, **more: Any) -> dict[str, Any]:
        """Chip, substrate and receiver with these BSDFs. The chip's bottom is the substrate itself, in contact."""
        half, wide = self.W / 2, 0.6 * self.S  # planes reach past the cell: no edge of theirs lies in it
        return {
            "type": "scene",
            "top": quad([0, 0, self.T], [0, 0, 1], half, half, bsdf=chip, **top),
            **{f"chip {name}": face for name, face in sides(half, self.T / 2, self.T / 2, 1, bsdf=chip).items()},
            "substrate": quad([0, 0, 0], [0, 0, 1], wide, wide, bsdf=substrate),
            "receiver": quad([0, 0, self.D], [0, 0, -1], wide, wide, bsdf=receiver),
            **more,
        }


# --- the particle loop: our physics, Mitsuba's intersections -------------------------------------------------------


def two(rng: mi.PCG32) -> mi.Point2f:
    """Two random numbers."""
    return mi.Point2f(rng.next_float32(), rng.next_float32())


def born(rng: mi.PCG32, cell: Cell, volume: bool) -> tuple[mi.Point3f, mi.Vector3f]:
    """Place (um) and direction of new particles: isotropic in the chip's volume, or Lambertian from its top face."""
    xy = cell.W * (two(rng) - 0.5)
    if volume:
        return mi.Point3f(xy.x, xy.y, cell.T * rng.next_float32()), mi.warp.square_to_uniform_sphere(two(rng))
    return mi.Point3f(xy.x, xy.y, cell.T + OFF_UM), mi.warp.square_to_cosine_hemisphere(two(rng))


def lobe_angle(u: mi.Float, sigma_rad: float) -> mi.Float:
    """Polar angle in rad about the mirror direction, density theta exp(-theta^2 / 2 sigma^2) / sigma^2."""
    return sigma_rad * dr.sqrt(-2 * dr.log(1 - u))


def about(mirror: mi.Vector3f, theta: mi.Float, u: mi.Float) -> mi.Vector3f:
    """The direction at the angle theta from `mirror`, at the azimuth 2 pi u."""
    (s, c), (sin_phi, cos_phi) = dr.sincos(theta), dr.sincos(dr.two_pi * u)
    return dr.normalize(mi.Frame3f(mirror).to_world(mi.Vector3f(s * cos_phi, s * sin_phi, c)))


@dr.syntax
def off_substrate(rng: mi.PCG32, d: mi.Vector3f, sigma_rad: float) -> tuple[mi.Vector3f, mi.PCG32]:
    """Direction after the substrate for `d` that came down; drawn again while it points below the surface."""
    out = mi.Vector3f(d)
    while out.z <= 0:
        theta = lobe_angle(rng.next_float32(), sigma_rad)
        out = about(mi.Vector3f(d.x, d.y, -d.z), theta, rng.next_float32())
    return out, rng


def at_chip(
    u: mi.Float, d: mi.Vector3f, n: mi.Vector3f, inside: mi.Bool, n_gan: float
) -> tuple[mi.Vector3f, mi.Bool]:
    """Direction after a face of the chip, and whether it then runs inside: one Fresnel decision, mean of s and p."""
    cos_in = -dr.dot(d, n)
    reflectance, cos_out, _, scale = mi.fresnel(cos_in, n_gan)
    crosses = u >= reflectance
    through = dr.normalize(scale * (d + n * cos_in) + n * cos_out)
    return dr.select(crosses, through, d + 2 * cos_in * n), inside ^ crosses


def bin_of(p: mi.Point3f, cell: Cell) -> mi.UInt32:
    """Number of the receiver's bin: row x bins + column, row 0 at the lowest y."""
    column = mi.UInt32(dr.clip((p.x / cell.S + 0.5) * cell.bins, 0, cell.bins - 1))
    row = mi.UInt32(dr.clip((p.y / cell.S + 0.5) * cell.bins, 0, cell.bins - 1))
    return row * cell.bins + column


def roulette(u: mi.Float, weight: mi.Float) -> mi.Float:
    """The weight, where it is small either raised to the threshold or 0, unchanged in the mean."""
    return dr.select(weight >= ROULETTE_BELOW, weight, dr.select(u * ROULETTE_BELOW < weight, ROULETTE_BELOW, 0))


@dr.syntax
def particles(
    cell: Cell, volume: bool, lanes: int, rounds: mi.UInt32, batches: int, seed: int, limit: mi.UInt32
) -> tuple[mi.Float, mi.Float64]:
    """Weights that arrived in each (batch, row, column) and the sums of LEDGER, for `lanes` x `rounds` histories.

    A lane whose history ends begins its next one in the same loop, so that no lane waits for the longest path of its
    neighbours. Lane i belongs to batch i mod `batches`. A history ends by roulette; after `limit` segments what it
    still carries is booked as truncated, what slips through an edge of the chip by rounding as lost.
    """
    scene = mi.load_dict(cell.scene(NULL, NULL, NULL, {}), optimize=False)  # optimised, shapes lose their names
    shapes = {shape.id(): mi.ShapePtr(shape) for shape in scene.shapes()}
    arrived, ledger = dr.zeros(mi.Float, batches * cell.bins**2), dr.zeros(mi.Float64, len(LEDGER))
    page = (dr.arange(mi.UInt32, lanes) % batches) * cell.bins**2
    rng = mi.PCG32(size=lanes, initstate=seed)
    o, d = born(rng, cell, volume)
    inside, weight = dr.full(mi.Bool, volume, lanes), dr.ones(mi.Float, lanes)
    left, segments, total = mi.UInt32(rounds) + dr.zeros(mi.UInt32, lanes), dr.zeros(mi.UInt32, lanes), mi.UInt32(0)
    half = cell.S / 2
    while left > 0:
        to_x, to_y = (dr.copysign(half, d.x) - o.x) / d.x, (dr.copysign(half, d.y) - o.y) / d.y
        ray = mi.Ray3f(o, d)
        ray.maxt = dr.maximum(dr.minimum(to_x, to_y), 0)
        si = scene.ray_intersect(ray, mi.RayFlags.Minimal, coherent=False)
        segments += 1
        lost = mi.Bool(False)
        if si.is_valid():
            n = mi.Vector3f(dr.round(si.n))  # faces are along the axes: exactly so
            if si.shape == shapes["substrate"]:
                d, rng = off_substrate(rng, d, cell.sigma_rad)
                weight *= cell.substrate
            elif si.shape == shapes["receiver"]:
                lost = mi.Bool(inside)
                dr.scatter_add(arrived, weight, page + bin_of(si.p, cell), ~lost)
                d = -mi.warp.square_to_cosine_hemisphere(two(rng))
                weight *= cell.receiver
            else:
                d, inside = at_chip(rng.next_float32(), d, n, inside, cell.n_gan)
            o = mi.Point3f(si.p + n * dr.copysign(OFF_UM, dr.dot(d, n)))
        else:  # at the cell's wall: goes on at the opposite one
            lost = mi.Bool(inside)
            o = ray(ray.maxt)
            o.x = dr.select(to_x <= to_y, -dr.copysign(half, d.x), o.x)
            o.y = dr.select(to_y < to_x, -dr.copysign(half, d.y), o.y)
        weight = roulette(rng.next_float32(), weight)
        dr.scatter_add(ledger, mi.Float64(weight), mi.UInt32(1), lost)
        dr.scatter_add(ledger, mi.Float64(weight), mi.UInt32(2), (segments >= limit) & ~lost)
        if (weight == 0) | lost | (segments >= limit):
            o, d = born(rng, cell, volume)
            inside, weight = mi.Bool(volume), mi.Float(1)
            left -= 1
            total, segments = total + segments, mi.UInt32(0)
    dr.scatter_add(ledger, dr.sum(mi.Float64(total)), mi.UInt32(0))
    return arrived, ledger


def run_particles(asked: dict[str, Any]) -> dict[str, Any]:
    """Maps of the particle loop by batch, its ledger per history, and its wall-clock time once compiled."""
    cell, lanes, batches = Cell(asked), asked["lanes"], asked["batches"]
    rounds, limit = -(-asked["histories"] // lanes), dr.opaque(mi.UInt32, asked["segment_limit"])

    def trace(count: int, seed: int) -> tuple[list[float], list[float], float]:
        begin = time.perf_counter()
        opaque = dr.opaque(mi.UInt32, count)  # a number in memory, so that the kernel is the same for every count
        arrived, ledger = particles(cell, asked["case"] == "B", lanes, opaque, batches, seed, limit)
        return list(arrived), list(ledger), time.perf_counter() - begin

    first_s = trace(1, asked["seed"] + 1)[2]
    arrived, ledger, seconds = trace(rounds, asked["seed"])
    histories = lanes * rounds
    relative = cell.bins**2 * batches / histories
    named = {name: value / histories for name, value in zip(LEDGER, ledger, strict=True)}
    maps = [weight * relative for weight in arrived]
    return {"histories": histories, "seconds": seconds, "first_s": first_s, "maps": maps, **named}


# --- Mitsuba's `path` integrator on the same cell ------------------------------------------------------------------


class GaussianLobe(mi.BSDF):
    """The substrate's lobe as a BSDF of Mitsuba, for paths that are traced from the receiver back to the source.

    Light from `wo` leaves along `wi` (Mitsuba's names) with the density p = g(theta) / (2 pi sin theta) / N(wo) per
    solid angle. theta is the angle between `wi` and the mirror direction of `wo`, the same as between `wo` and that
    of `wi`; N(wo) is the part of the lobe above the surface, since directions below are drawn again. The lobe is not
    reciprocal, so the roles matter: f cos(wo) = R p cos(wo) / cos(wi). Drawn from g alone; below the surface is 0.
    """

    NODES = 512

    def __init__(self, props: mi.Properties) -> None:
        mi.BSDF.__init__(self, props)
        self.sigma_rad, self.reflectance = props["sigma_rad"], props["reflectance"]
        self.m_flags = mi.BSDFFlags.GlossyReflection | mi.BSDFFlags.FrontSide
        self.m_components = [self.m_flags]
        self.above = mi.Float([above(math.pi / 2 * i / (self.NODES - 1), self.sigma_rad) for i in range(self.NODES)])

    def part_above(self, cos_theta: mi.Float) -> mi.Float:
        """N: the part of the lobe above the surface, interpolated in the mirror direction's elevation."""
        at = (dr.pi / 2 - dr.safe_acos(cos_theta)) * ((self.NODES - 1) / (math.pi / 2))
        low = dr.minimum(mi.UInt32(at), self.NODES - 2)
        a, b = dr.gather(mi.Float, self.above, low), dr.gather(mi.Float, self.above, low + 1)
        return dr.lerp(a, b, at - mi.Float(low))

    def density(self, wi: mi.Vector3f, wo: mi.Vector3f) -> mi.Float:
        """g(theta) / (2 pi sin theta) per solid angle."""
        theta = 2 * dr.safe_asin(0.5 * dr.norm(wo - mi.reflect(wi)))
        lobe = dr.exp(-0.5 * dr.square(theta / self.sigma_rad)) / (dr.two_pi * self.sigma_rad**2)
        return lobe * dr.select(theta > 1e-4, theta / dr.sin(theta), 1)

    def ratio(self, wi: mi.Vector3f, wo: mi.Vector3f) -> mi.Float:
        """f cos(wo) / density, 0 where one of them is below the surface."""
        both_above = (wi.z > 0) & (wo.z > 0)
        return dr.select(both_above, self.reflectance * wo.z / (wi.z * self.part_above(wo.z)), 0)

    def sample(self, ctx, si, sample1, sample2, active):  # noqa: ARG002 - Mitsuba's signature
        """A direction from g, with the weight that makes it right."""
        sample = mi.BSDFSample3f()
        sample.wo = about(mi.reflect(si.wi), lobe_angle(sample2.x, self.sigma_rad), sample2.y)
        sample.pdf, sample.eta = self.density(si.wi, sample.wo), 1.0
        sample.sampled_type, sample.sampled_component = mi.UInt32(+self.m_flags), 0
        return sample, dr.select(active, self.ratio(si.wi, sample.wo), 0)

    def eval(self, ctx, si, wo, active):  # noqa: ARG002 - Mitsuba's signature
        """f cos(wo)."""
        return dr.select(active, self.ratio(si.wi, wo) * self.density(si.wi, wo), 0)

    def pdf(self, ctx, si, wo, active):  # noqa: ARG002 - Mitsuba's signature
        """The density that `sample` draws from."""
        return dr.select(active & (si.wi.z > 0), self.density(si.wi, wo), 0)


def above(elevation_rad: float, sigma_rad: float, steps: int = 400) -> float:
    """Part of a lobe whose mirror direction has this elevation that points above the surface, by the midpoint rule.

    At the angle theta from the mirror direction the azimuths with tan(theta) cos(phi) < tan(elevation) are above.
    """
    total = 0.0
    for i in range(steps):
        theta = sigma_rad * math.sqrt(-2 * math.log(1 - (i + 0.5) / steps))
        total += 1 - math.acos(min(1.0, math.tan(elevation_rad) / math.tan(theta))) / math.pi
    return total / steps


def path_scene(cell: Cell) -> dict[str, Any]:
    """Case A for `path`: the chip's top radiates 1, mirrors bound the cell, a camera looks up at the receiver."""
    mi.register_bsdf("gaussian_lobe", GaussianLobe)
    glass = {"type": "dielectric", "int_ior": cell.n_gan, "ext_ior": 1.0}
    lobe = {"type": "gaussian_lobe", "sigma_rad": cell.sigma_rad, "reflectance": cell.substrate}
    white = {"type": "diffuse", "reflectance": {"type": "spectrum", "value": cell.receiver}}
    looks = mi.ScalarTransform4f().look_at(origin=[0, 0, cell.D - 1], target=[0, 0, cell.D], up=[0, 1, 0])
    film = {"type": "hdrfilm", "width": cell.bins, "height": cell.bins, "pixel_format": "luminance"}
    camera = {
        "type": "orthographic",
        "to_world": looks.scale([cell.S / 2, cell.S / 2, 1]),
        "near_clip": 0.01,
        "far_clip": 10.0,
        "film": {**film, "rfilter": {"type": "box"}},
        "sampler": {"type": "independent"},
    }
    shine = {"emitter": {"type": "area", "radiance": {"type": "spectrum", "value": 1.0}}}
    mirrors = sides(cell.S / 2, cell.D / 2, 0.6 * cell.D, -1, bsdf={"type": "conductor", "material": "none"})
    integrator = {"type": "path", "max_depth": -1}
    return cell.scene(glass, lobe, white, shine, **mirrors, sensor=camera, integrator=integrator)


def run_path(asked: dict[str, Any]) -> dict[str, Any]:
    """Maps of case A by the `path` integrator, one image a batch, and its wall-clock time once compiled.

    The receiver's radiance is L = rho E / pi and the chip's flux pi W^2, so E S^2 / flux = (L / rho) (S / W)^2.
    """
    cell = Cell(asked)
    scene = mi.load_dict(path_scene(cell), optimize=False)
    spp = max(1, asked["histories"] // (asked["batches"] * cell.bins**2))
    relative = (cell.S / cell.W) ** 2 / cell.receiver

    def image(seed: int) -> list[float]:
        return [value * relative for value in mi.render(scene, spp=spp, seed=seed).array]

    begin = time.perf_counter()
    image(asked["seed"] + asked["batches"])
    first_s = time.perf_counter() - begin
    begin = time.perf_counter()
    maps = [value for batch in range(asked["batches"]) for value in image(asked["seed"] + batch)]
    seconds = time.perf_counter() - begin
    histories = spp * asked["batches"] * cell.bins**2
    return {"histories": histories, "seconds": seconds, "first_s": first_s, "maps": maps}


def main() -> None:
    """Trace what the command line asks for."""
    asked = json.loads(sys.argv[1])
    dr.set_thread_count(asked["threads"])
    print(json.dumps({"path": run_path, "particles": run_particles}[asked["code"]](asked)))


if __name__ == "__main__":
    main()
