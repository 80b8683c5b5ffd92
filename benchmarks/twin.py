"""The deterministic twin beside Monte Carlo: four designs, random designs, a finite module, derivatives, images.

    python benchmarks/twin.py [designs] [random] [module] [derivatives] [images] [ways] [again] [mirror]

Each table says how the twin differs from long Monte Carlo runs and how well those are known. Exits are either
independent of each other, then both errors count, or the same in both, then what happens after the chip is compared
alone; "sd" is the expected difference by noise.
"""

from __future__ import annotations

import sys
from dataclasses import replace
from time import perf_counter, process_time

import numpy as np
from numpy.typing import NDArray

from containers.bsdf import Lambertian, Mirror
from containers.ray_tracing.arrays import EmissionArrays
from containers.ray_tracing.build import cell_of, scene_of
from containers.ray_tracing.exit_source import ExitSource
from containers.ray_tracing.exits import Exits, Landing, make_exits
from containers.ray_tracing.field import CellField, ModuleField
from containers.ray_tracing.monte_carlo import BLOCK
from containers.ray_tracing.packing import emission_arrays
from containers.ray_tracing.tally import Tally
from containers.ray_tracing.twin.cell import cell_field
from containers.ray_tracing.twin.columns import COLUMNS, film_column
from containers.ray_tracing.twin.direct import Way, direct_light, open_way
from containers.ray_tracing.twin.module import ModuleTwin, surroundings
from containers.ray_tracing.twin.prediction import Shot, jacobian, twin_images
from containers.ray_tracing.twin.supply import Supply
from containers.ray_tracing.twin.ways import Ways
from containers.ray_tracing.uniformity import cell_region, uniformity
from containers.ray_tracing.worker import RayComputation
from containers.scene import Array, Cell, Emission, Receiver, Scene
from containers.stack import dbr_of
from containers.thin_film.table import film_table
from luxloop.camera import Camera
from luxloop.computation import Progress
from luxloop.design import Bounds, Design
from luxloop.film import Spectrum
from luxloop.model import Environment
from luxloop.model_file import find_model
from luxloop.ray import ChipArray, PredictionRequest, ShotRequest

Real = NDArray[np.float64]
DESIGNS = {
    "S_b3, none": (180.0, 28.0, 500.0, 35.0, 0.0),
    "S_b3, 6.5": (180.0, 28.0, 500.0, 35.0, 6.5),
    "S_b1, 5.5": (180.0, 40.0, 400.0, 20.0, 5.5),
    "S_b2, 5.5": (160.0, 20.0, 460.0, 15.0, 5.5),
}
MODELS = "clear_chip", "paper"
AGAIN = 0.3, 0.31, 0.32, 0.33, 0.34
"""Reflectances of the receiver, one after the other."""


def scene_at(environment: Environment, design: Design) -> Scene:
    """A cell of the design with its film."""
    spectrum = Spectrum(peak_nm=environment.peak_nm, fwhm_nm=environment.fwhm_nm)
    film = film_table(dbr_of(environment, design.dbr_pairs), spectrum) if design.dbr_pairs else None
    return scene_of(environment, design, film, cell_of(environment, design))


def compared(scene: Scene, exits: tuple[Exits, Exits], seeds: int) -> str:
    """A row: U and map of the twin less those of Monte Carlo, each with exits of its own landed with several seeds.

    Where the two have the same exits, the noise is that of the seeds, else that of the exits' groups.
    """
    region, found = cell_region(scene.layout.spacing_um), ([], [])
    for seed in range(seeds):
        tally = Landing(scene, exits[1], seed, survival=1.0).run_to(exits[1].histories)
        bins, S = tally.cell_bins(), scene.layout.spacing_um
        long = CellField.from_bins(bins, tally.histories, S, scene.height_um, folded=True)
        start = perf_counter()
        field = cell_field(scene, exits[0], seed=1000 + seed)
        twin_s = perf_counter() - start
        for kept, one in zip(found, (field, long), strict=True):
            kept.append(one.coefficients)
    axis = 1 if exits[0] is exits[1] else 0
    own, other = (replace(field, coefficients=np.mean(kept, axis=axis)) for kept in found)
    u, maps, mean = (
        [uniformity(one, region) for one in (own, other)],
        [one.map(64) for one in (own, other)],
        other.mean,
    )
    rms = 100.0 * np.sqrt(np.mean((maps[0].mean(axis=0) - maps[1].mean(axis=0)) ** 2)) / mean
    noise = 100.0 * np.sqrt(np.mean(sum(one.var(axis=0, ddof=1) / len(one) for one in maps))) / mean
    sd, change = np.hypot(u[0].standard_error, u[1].standard_error), u[0].value - u[1].value
    return (
        f"{100 * u[1].value:7.2f} {100 * change:+6.2f} {100 * sd:5.2f}   {rms:6.2f} {noise:6.2f}   "
        f"{100 * (own.mean / mean - 1):+7.3f}   {twin_s:5.2f} s"
    )


HEAD = "     U %   twin-MC   sd   map rms %  of it noise  mean %    twin"


def designs() -> None:
    """The four designs of the paper under both models."""
    print("four designs, 8.4 M histories of exits, others in both, landed twice\n" + " " * 22 + HEAD)
    for model in MODELS:
        for name, numbers in DESIGNS.items():
            scene = scene_at(find_model(model).environment, Design.from_vector(numbers))
            exits = make_exits(scene, 11, 256 * BLOCK), make_exits(scene, 12, 256 * BLOCK)
            print(f"{model:10s} {name:11s}", compared(scene, exits, 2), flush=True)


def random_designs(count: int = 50) -> None:
    """Random designs of the paper's grid, the models in turn."""
    print(f"{count} random designs of the grid, equal exits of 1 M histories, landed 6 times\n" + " " * 55 + HEAD)
    rng, done = np.random.default_rng(5), 0
    grid = list(Bounds.preset("paper-grid").grid())
    while done < count:
        design = grid[rng.integers(len(grid))]
        if design.feasibility() is not None:
            continue
        model = MODELS[done % 2]
        done += 1
        scene = scene_at(find_model(model).environment, design)
        exits = make_exits(scene, 11, 32 * BLOCK)
        print(f"{model:10s} {design!s:44s}", compared(scene, (exits, exits), 6), flush=True)


def module() -> None:
    """5 x 5 chips and a single one, whole receiver, against Monte Carlo with its eight images averaged."""
    print("finite modules of S_b3, 0.5 M histories of exits in both, both landed 12 times; % of the mean")
    for model in MODELS:
        for count, half in ((5, None), (1, 500.0)):
            cell = scene_at(find_model(model).environment, Design.from_vector(DESIGNS["S_b3, none"]))
            scene = replace(cell, layout=Array.regular(count, count, 500.0, half))
            exits, maps = make_exits(scene, 11, 16 * BLOCK), []
            at = np.linspace(-scene.layout.half_x_um, scene.layout.half_x_um, 66)[1:-1]
            for seed in range(12):
                tally = Landing(scene, exits, seed, survival=1.0).run_to(16 * BLOCK)
                maps.append(eight_images(module_of_tally(tally, scene).grid(at, at)[0]))
            twin = np.mean(
                [eight_images(ModuleTwin(scene, exits, seed=seed).mean(at, at)) for seed in range(12)], axis=0
            )
            long = np.mean(maps, axis=0)
            noise = np.sqrt(np.mean(np.var(maps, axis=0, ddof=1)) / 12) / long.mean()
            rms = np.sqrt(np.mean((twin - long) ** 2)) / long.mean()
            change = twin.mean() / long.mean() - 1.0
            row = f"mean {100 * change:+.3f}, rms {100 * rms:.2f}, noise of Monte Carlo {100 * noise:.2f}"
            print(f"{model:10s} {count} x {count}: {row}", flush=True)


def module_of_tally(tally: Tally, scene: Scene) -> ModuleField:
    """Monte Carlo's field of a finite module, all groups together twice."""
    whole, histories = tally.cell_bins().sum(axis=0), tally.total_histories / scene.layout.power.size
    return ModuleField.from_bins(np.stack([whole] * 2), histories, tally.box.ends_um, scene.height_um)


def eight_images(image: Real) -> Real:
    """The mean of a map and its mirror images."""
    four = (image + image[::-1] + image[:, ::-1] + image[::-1, ::-1]) / 4.0
    return (four + four.T) / 2.0


def walks(scene: Scene) -> Exits:
    """Exits that are the same whoever asks."""
    return make_exits(scene, 11, 16 * BLOCK, notes=True)


def show(coefficients: Real) -> str:
    """The three lowest modes."""
    return " ".join(f"{1e5 * coefficients[mode]:8.1f}" for mode in ((0, 0), (0, 1), (1, 1)))


def derivatives(names: tuple[str, ...] = tuple(COLUMNS)) -> None:
    """Changes of the lowest waves of a cell, beside central differences of Monte Carlo with common random numbers."""
    for model in MODELS:
        scene = scene_at(find_model(model).environment, Design.from_vector(DESIGNS["S_b3, 6.5"]))
        print(
            f"{model}, S_b3 6.5: change of modes (0,0) (1,0) (1,1) over two steps, 1e-5; twin | Monte Carlo | error"
        )
        supply = Supply(walks)
        for name in names:
            column = COLUMNS[name]
            (up, _), (down, _) = column.stencil(scene)[-2:]
            ends = [column.move(scene, amount) for amount in (up, down)]
            twin = np.subtract(*[cell_field(s, supply.of(s, scene)).coefficients for s in ends])
            long = []
            for s in ends:
                tally = Landing(s, make_exits(s, 21, 64 * BLOCK), 5, survival=1.0).run_to(64 * BLOCK)
                bins, S = tally.cell_bins(), s.layout.spacing_um
                long.append(CellField.from_bins(bins, tally.histories, S, s.height_um, folded=True).coefficients)
            mc = np.subtract(*long)
            errors = [d.std(axis=0, ddof=1) / np.sqrt(len(d)) for d in (twin, mc)]
            print(
                f"  {name:22s} {show(twin.mean(axis=0))} | {show(mc.mean(axis=0))} | {show(np.hypot(*errors))}",
                flush=True,
            )


def images() -> None:
    """Six camera images with exits at hand, and all columns of the Jacobian."""
    clear = find_model("clear_chip").environment
    shots = []
    for pairs in (0.0, 5.5, 6.5):
        cell = scene_at(clear, Design.from_vector((180.0, 28.0, 500.0, 35.0, pairs)))
        shots += [
            Shot(replace(cell, layout=Array.regular(n, n, 500.0, half)), Camera(psf_um=10.0))
            for n, half in ((1, 600.0), (5, None))
        ]
    supply = Supply(lambda scene: make_exits(scene, 7, 4 * BLOCK, notes=True))
    print("six images of 128 x 128 at 8 um (single chips and 5 x 5), exits at hand")
    for blocks in (1, 4):
        options = {"blocks": blocks, "shadow_rays": 4096}
        twin_images(shots, supply, **options)
        times = []
        for _ in range(7):
            wall, cpu = perf_counter(), process_time()
            twin_images(shots, supply, **options)
            times.append((perf_counter() - wall, process_time() - cpu))
        best = np.min(times, axis=0)
        print(f"  {blocks * 32768:7d} histories: wall {1e3 * best[0]:.0f} ms, cpu {1e3 * best[1]:.0f} ms, best of 7")
    columns = [*COLUMNS.values(), film_column(lambda _: shots[-1].scene.chip.top)]
    start = perf_counter()
    found = jacobian(shots, columns, supply, blocks=1, shadow_rays=4096)
    print(f"  Jacobian {found.shape}: {perf_counter() - start:.1f} s, new walks in moved chips included")


def ways() -> None:
    """Direct light of a chip among its neighbours: exits followed, and landed where they are known to come."""
    print("direct light, model paper, 131072 histories of exits, one thread, CPU ms, best of 7")
    environment = find_model("paper").environment
    for pairs in (0.0, 5.5):
        cell = scene_at(environment, Design.from_vector((180.0, 40.0, 400.0, 20.0, pairs)))
        for n in (1, 5):
            lit = replace(cell, layout=Array.regular(n, n, 400.0))
            exits, known = make_exits(lit, 7, 4 * BLOCK, notes=True), Ways()
            way = open_way(*surroundings(lit, Array.regular(n, n, 400.0)))
            emission = emission_arrays(replace(lit, layout=Cell(400.0)))
            landed(way, emission, exits, Ways())  # compiled
            first = landed(way, emission, exits, known)[1]
            (alone, followed), (again, known_ms) = (
                min((landed(way, emission, exits, by) for _ in range(7)), key=lambda one: one[1])
                for by in (None, known)
            )
            same = "the same bits" if np.array_equal(alone.bins, again.bins) else "OTHER BITS"
            took = f"followed {followed:5.1f}, first {first:5.1f}, known {known_ms:5.1f}"
            print(f"  {pairs:3.1f} pairs, {n} x {n}: {took}; {same}")


def landed(way: Way, emission: EmissionArrays, exits: Exits, known: Ways | None) -> tuple[Tally, float]:
    """Direct light on one thread, and the CPU that it took, in ms."""
    begun = process_time()
    found = direct_light(way, emission, exits, 1, groups=2, threads=1, known=known)
    return found, 1e3 * (process_time() - begun)


def again() -> None:
    """What a diagnosis asks for again and again: other reflectances of the receiver, the same chips and ways."""
    print("a request of a single chip and 5 x 5, two designs, again with another receiver; CPU s, median of 5")
    environment, wanted = find_model("paper").environment, {"rows": 42, "columns": 42, "pixel_um": 24.0}
    designs = [Design.from_vector((180.0, 40.0, 400.0, thickness, 0.0)) for thickness in (20.0, 40.0)]
    for histories in (131_072, 262_144, 524_288):
        worker = RayComputation(lambda *_: b"", ExitSource())

        def took(reflectance: float, worker: RayComputation = worker, histories: int = histories) -> float:
            receiver = environment.receiver.model_copy(update={"reflectance": reflectance})
            lit = environment.model_copy(update={"receiver": receiver})
            shots = [
                ShotRequest(environment=lit, design=one, array=ChipArray(rows=n, columns=n), camera=Camera(**wanted))
                for one in designs
                for n in (1, 5)
            ]
            inputs = PredictionRequest(shots=tuple(shots), exit_histories=histories).model_dump(mode="json")
            begun = process_time()
            worker.compute(inputs, Progress())
            return process_time() - begun

        first = took(0.35)
        print(f"  {histories:7d} histories: first {first:5.2f}, again {np.median([took(r) for r in AGAIN]):5.2f}")


def mirror() -> None:
    """Case A: light from the chip's top over three substrates, the closed form alone, and with the chips."""
    scene = scene_at(find_model("clear_chip").environment, Design.from_vector(DESIGNS["S_b3, none"]))
    lambertian = Emission(from_top=True)
    for name, substrate in (("mirror", Mirror(0.97)), ("lobe", scene.substrate), ("Lambertian", Lambertian(0.97))):
        case = replace(scene, emission=lambertian, substrate=substrate, receiver=Receiver(Lambertian(0.35)))
        exits = make_exits(case, 1, 128 * BLOCK)
        maps = [Landing(case, exits, seed, survival=1.0).run_to(128 * BLOCK).cell_bins() for seed in (1, 2)]
        S, height = case.layout.spacing_um, case.height_um
        long = CellField.from_bins(np.mean(maps, axis=0), 128 * BLOCK, S, height, folded=True)
        for shadow in (False, True):
            field = cell_field(case, exits, shadow=shadow)
            own, other = field.map(64).mean(axis=0), long.map(64).mean(axis=0)
            rms, change = np.sqrt(np.mean((own - other) ** 2)) / other.mean(), field.mean / long.mean - 1.0
            chips = f"chips {'counted' if shadow else 'ignored':8s}"
            print(
                f"case A, {name:10s} {chips}: mean {long.mean:.4f} {100 * change:+.3f} %, map rms {100 * rms:.2f} %"
            )


SECTIONS = {
    "designs": designs,
    "random": random_designs,
    "module": module,
    "derivatives": derivatives,
    "images": images,
    "ways": ways,
    "again": again,
    "mirror": mirror,
}

if __name__ == "__main__":
    for wanted in sys.argv[1:] or SECTIONS:
        SECTIONS[wanted]()
