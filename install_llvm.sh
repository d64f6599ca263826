#!/bin/sh
# Makes sure that Mitsuba can compute: a CUDA device, or a libLLVM of 19 or newer (Dr.Jit brings none).
#
#   install_llvm.sh VENV      as root: apt-get install; otherwise: unpacked into VENV/lib/llvm
#   HOLOPATH_LLVM=user        unpack into VENV/lib/llvm in any case
set -eu
venv=$1
mode=${HOLOPATH_LLVM:-auto}

state() { # prints what Mitsuba's LLVM backend would use or lacks; fails where no backend can be used
  "$venv/bin/python" - <<'PY'
from holopath_addon.engine import backend

rows = backend.describe()
print(*(row["detail"] for row in rows if row["name"] == backend.LLVM))
raise SystemExit(not any(row["available"] for row in rows))
PY
}

give_up() {
  echo "make env: $1" >&2
  exit 1
}

if [ "$mode" != user ] && found=$(state); then
  echo "$found"
  exit 0
fi
if [ -n "${DRJIT_LIBLLVM_PATH:-}" ] || ! command -v apt-get >/dev/null; then
  give_up "$(state || true)"
fi

work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
private="" # apt's options where the system's package lists are missing or old and we may not renew them

package() { # the oldest package that will do, if the package lists name one
  for version in 19 20 21 22; do
    # shellcheck disable=SC2086
    if [ -n "$(apt-cache $private show "libllvm$version" 2>/dev/null)" ]; then
      echo "libllvm$version"
      return
    fi
  done
  return 1
}

install_as_root() {
  name=$(package) && DEBIAN_FRONTEND=noninteractive apt-get install -y -qq --no-install-recommends "$name" >"$work/log" 2>&1
}

fetch() { # unpacks the library, and of what it depends on all that is not installed, into one folder
  name=$(package) || return 1
  # shellcheck disable=SC2086
  names=$(apt-cache $private depends --recurse --no-recommends --no-suggests --no-conflicts --no-breaks \
    --no-replaces --no-enhances "$name" | grep -E '^[a-z]' | cut -d: -f1 | sort -u |
    grep -vE '^(libc6|libgcc-s1|libstdc\+\+6|libcrypt1|gcc-.*)$') # Python itself has these loaded
  rm -rf "$work/debs" "$work/root" && mkdir -p "$work/debs" "$work/root" "$work/lib"
  for each in $names; do
    if [ "$each" = "$name" ] || ! dpkg-query -W -f='${Status}' "$each" 2>/dev/null | grep -q 'ok installed'; then
      # shellcheck disable=SC2086
      (cd "$work/debs" && apt-get $private download -qq "$each" >>"$work/log" 2>&1) || return 1
    fi
  done
  for deb in "$work"/debs/*.deb; do dpkg -x "$deb" "$work/root"; done
  for folder in "$work"/root/lib/*-linux-gnu "$work"/root/usr/lib/*-linux-gnu; do
    [ -d "$folder" ] && find "$folder" -maxdepth 1 -name '*.so*' -exec mv {} "$work/lib/" \;
  done
  rm -rf "$venv/lib/llvm" && mv "$work/lib" "$venv/lib/llvm"
}

if [ "$mode" != user ] && [ "$(id -u)" = 0 ]; then
  echo "installing a libLLVM of 19 or newer with apt-get"
  install_as_root || { apt-get update -qq >"$work/log" 2>&1 && install_as_root; } || tail -n 3 "$work/log" >&2 || true
else
  echo "unpacking a libLLVM of 19 or newer into $venv/lib/llvm"
  if ! fetch; then
    mkdir -p "$work/state/lists/partial" "$work/cache/archives/partial"
    private="-o Dir::State=$work/state -o Dir::State::status=/var/lib/dpkg/status -o Dir::Cache=$work/cache"
    # shellcheck disable=SC2086
    { apt-get $private update -qq >"$work/log" 2>&1 && fetch; } || tail -n 3 "$work/log" >&2 || true
  fi
fi
found=$(state) || give_up "$found"
echo "$found"
