#!/bin/sh
# The first thing in every container: see that it may write where it must, bring the kernels, become the command.
set -eu

refuse() { # folder, its name on the host, mend
  printf '%s\n' "luxloop: uid $(id -u) cannot write $2, which belongs to uid $(stat -c %u "$1"): $3" >&2
  exit 2
}

if [ "${RAY_WORKERS:-1}" -lt 1 ]; then # the campaign would wait for one without a word; 00 is none, too
  echo "luxloop: RAY_WORKERS is $RAY_WORKERS, allowed: 1 or more, for campaigns wait for a ray worker;" \
    "leave it out for 1" >&2
  exit 2
fi
if [ -n "${LUXLOOP_RUNS:-}" ] && [ ! -w "$LUXLOOP_RUNS" ]; then
  if [ "$(stat -c %u "$LUXLOOP_RUNS")" = 0 ]; then # not to be mended by containers that run as root
    refuse "$LUXLOOP_RUNS" ./runs "on the host, chown $(id -u):$(id -g) runs effects"
  fi
  refuse "$LUXLOOP_RUNS" ./runs \
    "on the host, (echo UID=\$(id -u); echo GID=\$(id -g)) >>.env says who you are; or give the folder to $(id -u)"
fi
if [ -n "${LUXLOOP_CACHE:-}" ] && [ ! -w "$LUXLOOP_CACHE" ]; then
  refuse "$LUXLOOP_CACHE" "the volume at $LUXLOOP_CACHE" "docker compose down --volumes, then start again"
fi

# Compiled kernels lie in a folder named by the digest of their sources. A copy is finished under another name first:
# several workers may start at once on one volume, and the first one wins.
for kernels in /opt/luxloop/kernels/*/; do
  target=${LUXLOOP_CACHE:-/tmp}/kernels/$(basename "$kernels")
  { [ -d "$kernels" ] && [ ! -d "$target" ]; } || continue
  mkdir -p "${target%/*}"
  copy=$(mktemp -d "${target%/*}/.new-XXXXXX")
  cp -Rp "$kernels." "$copy"
  mv -T "$copy" "$target" 2>/dev/null || rm -rf "$copy"
done

exec "$@"
