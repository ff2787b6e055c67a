#!/bin/sh
# Installs the programs that some tests need, where apt-get may; says what is missing elsewhere.
set -u
missing=""
add() {
    command -v "$1" >/dev/null 2>&1 || missing="$missing $2"
}
add gcc "gcc libc6-dev"
add arm-none-eabi-gcc "gcc-arm-none-eabi libnewlib-arm-none-eabi"
add qemu-system-arm qemu-system-arm
add avr-gcc "gcc-avr avr-libc"
add simavr simavr
add cppcheck cppcheck
add chromium chromium
if [ -z "$missing" ]; then
    echo "tools: all there"
    exit 0
fi
root=""
if [ "$(id -u)" != 0 ]; then
    if ! sudo -n true 2>/dev/null; then
        echo "tools: missing:$missing; install them as root (sudo asks for a password)" >&2
        exit 1
    fi
    root="sudo -n"
fi
if ! command -v apt-get >/dev/null 2>&1; then
    echo "tools: missing:$missing; there is no apt-get here, install what they are called here" >&2
    exit 1
fi
export DEBIAN_FRONTEND=noninteractive
# shellcheck disable=SC2086
if ! { $root apt-get -qq update && $root apt-get -qq install --yes --no-install-recommends $missing; }; then
    echo "tools: missing:$missing; apt-get could not install them" >&2
    exit 1
fi
echo "tools: installed$missing"
