#!/usr/bin/env bash
# Checks docker-compose.yml from nothing, as a fresh clone would have it, and prints what it saw:
#   docker/check.sh           in a copy of the work tree, as a project of its own, removed at the end with its images,
#                             which have the tag check: those of `docker compose up` stay as they are
#   docker/check.sh --cold    first drops the engine's whole build cache, so that the first build is a cold one
# The build takes its settings from the environment: BASE_IMAGE, TORCH_INDEX, PIP_INDEX_URL, PIP_NO_INDEX (see
# docs/docker.md), and wheels from docker/wheels/. Needs a Docker engine, git, and a user who may use it; takes minutes.
set -euo pipefail
cd "$(dirname "$0")/.."
clone=$(mktemp -d)
export COMPOSE_PROJECT_NAME=luxloop-check IMAGE_TAG=check BUILDKIT_PROGRESS=quiet COMPOSE_ANSI=never
GID=$(id -g)
[ "$(id -u)" = 0 ] || export UID GID

say() { printf '%-28s %s\n' "$@"; }
heading() { printf '\n== %s\n' "$1"; }
now() { date +%s.%N; }
since() { awk -v a="$1" -v b="$(now)" 'BEGIN { printf "%.1f s", b - a }'; }
timed() { # what, command ...: prints how long it took; what it said is shown only where it failed
  local what=$1 begin code=0
  shift
  begin=$(now)
  "$@" >"$clone/said" 2>&1 || code=$?
  say "$what" "$(since "$begin")"
  [ "$code" = 0 ] || { cat "$clone/said"; return "$code"; }
}
run() { # without dependencies: they would be scaled back to one worker each
  docker compose run --rm -T --no-deps campaign "$@" 2>"$clone/said-$BASHPID" || { cat "$clone/said-$BASHPID"; return 1; }
}
megabytes() { awk '{ printf "%.0f MB", $1 / 1e6 }'; }
size() { docker image inspect --format '{{.Size}}' "$1" | megabytes; }
memory() { docker stats --no-stream --format '{{.Name}} {{.MemUsage}}' $(docker compose ps -q) |
  sed "s/^$COMPOSE_PROJECT_NAME-//" | sort | while read -r name used; do say "memory of $name" "$used"; done; }
leave() {
  docker compose down --remove-orphans --timeout 20 >/dev/null 2>&1 || true # a campaign under way, too
  docker compose down --volumes --rmi all >/dev/null 2>&1 || true
  docker image prune --force --filter "label=com.docker.compose.project=$COMPOSE_PROJECT_NAME" >/dev/null || true
  rm -rf "$clone"
}
trap leave EXIT

git ls-files -co --exclude-standard -z | xargs -0 ls -d 2>/dev/null | tar -cf - -T - | tar -C "$clone" -xf -
cp docker/wheels/*.whl "$clone/docker/wheels/" 2>/dev/null || true
cd "$clone"
mkdir -p effects
[ "$(id -u)" != 0 ] || chown -R 1000:1000 runs effects # the services run as uid 1000 then
docker compose down --volumes >/dev/null 2>&1

heading "build, on $(nproc) cores, engine $(docker version --format '{{.Server.Version}}'), compose $(docker compose version --short)"
if [ "${1:-}" = --cold ]; then
  docker builder prune --all --force >/dev/null
fi
timed "first build" docker compose build
timed "nothing changed" docker compose build
echo "# a change" >>agent/launch.py
timed "a file of agent/ changed" docker compose build
for image in core workers designer; do say "size of luxloop-$image" "$(size luxloop-$image:$IMAGE_TAG)"; done
say "of which the base image" "$(size "${BASE_IMAGE:-python:3.11-slim}")"

heading "docker compose up, on empty volumes"
timed "all healthy after" docker compose up -d
begin=$(now)
code=$(docker wait "$(docker compose ps -aq campaign)")
say "campaign" "exit code $code after $(since "$begin")"
docker logs "$(docker compose ps -aq campaign)" 2>&1 | sed 's/^/    /'
[ "$code" = 0 ]
say "in ./runs" "$(cd runs && echo */*)"
[ -s runs/*/report.html ]

heading "each service: who it is, what it may, which keys it sees"
for service in router pc1 pc2 pc3; do
  say "$service" "$(docker compose exec -T $service sh -c '
    echo "uid $(id -u), capabilities $(grep CapEff /proc/self/status | cut -f2), /certs: $(ls /certs | tr "\n" " ")"
    touch /here 2>/dev/null && echo "but it can write /"; true')"
done

heading "idle, after a restart"
docker compose up -d --force-recreate --no-deps router pc1 pc2 pc3 >/dev/null 2>&1
timed "all healthy after" docker compose up -d --wait --no-recreate pc1 pc2 pc3
sleep 15
memory
say "a health check takes" "$(docker compose exec -T pc3 python -c '
import resource, subprocess
code = subprocess.call(["python", "/opt/luxloop/healthy.py", "connected"])
used = resource.getrusage(resource.RUSAGE_CHILDREN)
print(f"{1e3 * (used.ru_utime + used.ru_stime):.0f} ms of a core, exit code {code}")')"

heading "two ray workers, one killed with -9 while a campaign runs"
export LUXLOOP_THREADS=1
timed "scaled after" docker compose up -d --wait --scale pc3=2 pc1 pc2 pc3
short=(--evaluations 60 --quiet)
run campaign run --id killed "${short[@]}" >"$clone/killed" &
campaign=$!
steps() { run campaign status killed --json 2>/dev/null | grep -o '"steps": [0-9]*' | cut -d' ' -f2; }
until [ -d runs/killed ]; do sleep 0.2; done
until [ "$(steps)" -ge 10 ]; do sleep 0.5; done
docker compose exec -T --index 1 pc3 sh -c 'kill -9 -1' || true # all but its init, which ends then
say "killed" "pc3-1, after $(steps) steps"
code=0
wait $campaign || code=$?
say "campaign" "exit code $code"
sed 's/^/    /' "$clone/killed"
[ "$code" = 0 ]
say "restarts of pc3-1" "$(docker inspect --format '{{.RestartCount}}' $COMPOSE_PROJECT_NAME-pc3-1)"
docker compose restart pc1 >/dev/null 2>&1 # it would have the answers at hand
run campaign run --id calm "${short[@]}" >"$clone/calm"
results() { grep -E '^(best|finalist|start|without)' "$1"; }
diff <(results "$clone/calm") <(results "$clone/killed")
say "the undisturbed campaign" "finds the same, to the last digit: $(grep '^evaluated' "$clone/calm" | tr -s ' ')"

heading "docker compose run --rm campaign ..."
for words in "campaign list" "audit verify killed" "doctor"; do
  printf '$ docker compose run --rm campaign %s\n' "$words"
  run $words | sed 's/^/    /'
done

heading "a user's own effect: written, checked, simulated; a broken one refused"
run effects new my_warmth --stage module | sed 's/^/    /'
run effects check my_warmth --quick >"$clone/checked" || { cat "$clone/checked"; false; }
sed 's/^/    /' "$clone/checked"
design=(simulate --design 180,40,500,20,2.5 --method twin)
{ cat luxloop/models/paper.toml; echo; sed -n '/^\[\[effects\]\]/,$p' "$clone/checked" | tr -d '\r'; } >runs/warm.toml
uniformity() { run "${design[@]}" "$@" | grep -m1 'uniformity (Eq' | tr -s ' '; }
plain=$(uniformity) warm=$(uniformity --model runs/warm.toml)
say "without it" "$plain"
say "with it" "$warm"
[ "$plain" != "$warm" ]
cat >effects/bright.py <<'EOF'
from containers.effect import DetectorEffect, parameter


class Bright(DetectorEffect):
    """It makes light."""

    name, formula, reference = "bright", "E (1 + s)", "none"
    share: float = parameter("s", unit="", lower=0.0, upper=0.5, off=0.0)

    def light(self, image, camera):
        return image * (1.0 + self.share)
EOF
run effects list | grep -E '^refused|my_warmth' | sed 's/^/    /'
[ "$(uniformity)" = "$plain" ]
say "the worker after it" "answers as before"

heading "a uid that cannot write ./runs"
code=0
env UID=4242 docker compose run --rm -T certs >"$clone/said" 2>&1 || code=$?
grep '^luxloop' "$clone/said"
say "exit code" "$code"

heading "down"
timed "docker compose down" docker compose down --volumes
say "left behind" "$(docker ps -aq --filter name=$COMPOSE_PROJECT_NAME | wc -l) containers, $(docker volume ls -q --filter name=$COMPOSE_PROJECT_NAME | wc -l) volumes"
