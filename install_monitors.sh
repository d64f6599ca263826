#!/bin/sh
# For the tests of the display driver: an X server with two virtual monitors (Xorg and its dummy driver).
# Without it those tests are skipped.
set -eu
driver() { ls /usr/lib/xorg/modules/drivers/dummy_drv.so /usr/lib64/xorg/modules/drivers/dummy_drv.so 2>/dev/null; }

if command -v Xorg >/dev/null && [ -n "$(driver)" ]; then
  exit 0
fi
if [ "$(uname)" = Linux ] && [ "$(id -u)" = 0 ] && command -v apt-get >/dev/null; then
  packages="xserver-xorg-core xserver-xorg-video-dummy libxtst6" # the last one presses keys
  export DEBIAN_FRONTEND=noninteractive
  # shellcheck disable=SC2086
  apt-get install -y -qq --no-install-recommends $packages >/dev/null 2>&1 ||
    { apt-get update -qq >/dev/null 2>&1 && apt-get install -y -qq --no-install-recommends $packages >/dev/null 2>&1; } ||
    true
fi
if ! command -v Xorg >/dev/null || [ -z "$(driver)" ]; then
  echo "make env: no X server with virtual monitors: tests of the display driver will be skipped (Debian, Ubuntu:" \
    "apt install xserver-xorg-core xserver-xorg-video-dummy)." >&2
fi
