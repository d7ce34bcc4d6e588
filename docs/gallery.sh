#!/usr/bin/env bash
# Makes the pictures of README and guide from the demo model, in about ten minutes:
#
#     cargo build --release --examples --bins && docs/gallery.sh [DIRECTORY]
#
# DIRECTORY keeps the demo and all that is made of it.
set -euo pipefail
cd "$(dirname "$0")/.."

target=${CARGO_TARGET_DIR:-target}/release
cape=$(realpath "$target/cape")
examples=$(realpath "$target/examples")
work=${1:-$(mktemp -d)}
pictures=$PWD/docs/guide/src/pictures
mkdir -p "$work" "$pictures"
cd "$work"

[[ -e demo ]] || "$cape" demo --out demo
"$cape" fit-prior demo/run --components 1

make() {
    local name=$1
    shift
    rm -rf "$name"
    "$cape" "$@" --out "$name"
}

make outfits vary demo/run --by outfit --rows 2 --prior gmm --temperature 0.7 --seed 2
make codes vary demo/run --by code --outfit shortlong --prior gmm
make poses vary demo/run --by pose --motion squats --prior gmm --temperature 0.5
make shapes vary demo/run --by shape --outfit shortshort --prior gmm --temperature 0.5
make directions vary demo/run --by direction --rows 3 --columns 5
make between vary demo/run --by between --codes frame:0,frame:120
make effect pose-effect demo/run --pose-a a-pose --pose-b squats --prior gmm --temperature 0.5
make redressed redress demo/run frame:0 --pose squats
make squats animate demo/run --motion squats --seconds 2 --fps 12 --size 256 --prior gmm --temperature 0.5
"$examples/texture" demo/run
"$examples/picture"

for name in outfits codes poses shapes directions between; do
    cp "$name/variations.png" "$pictures/$name.png"
done
cp effect/pose_effect.png "$pictures/effect.png"
cp redressed/redress.png "$pictures/redressed.png"
cp squats/animation.png "$pictures/squats.png"
cp texture.png picture.png "$pictures"
cp demo/contact_sheet.png "$pictures/../../../contact_sheet.png"
