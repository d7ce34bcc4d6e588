#!/usr/bin/env bash
# Makes the pictures of the README and the book's guide from the run of the built-in model, whose
# commands are in docs/book/src/experiments/model.md.
#
#     cargo build --release --workspace --examples --bins && docs/gallery.sh RUN [DIRECTORY]
#
# DIRECTORY keeps the demo and everything that is made. Not made here are viewer.png, fitted.png,
# fitting-benchmark.png, table2-report.png and the layer-*.png: see the pages that show them.
set -euo pipefail
run=$(realpath "${1:?RUN is missing}")
cd "$(dirname "$0")/.."

target=${CARGO_TARGET_DIR:-target}/release
cape=$(realpath "$target/cape")
examples=$(realpath "$target/examples")
work=${2:-$(mktemp -d)}
pictures=$PWD/docs/book/src/pictures
mkdir -p "$work" "$pictures"
cd "$work"

[[ -e demo ]] || "$cape" demo --out demo

# make DIRECTORY COMMAND ARGUMENT…: runs the command with --out DIRECTORY, anew.
make() {
    local name=$1
    shift
    rm -rf "$name"
    "$cape" "$@" --out "$name"
}

make outfits vary "$run" --by outfit --codes seed:4,seed:5 --rows 2
make codes vary "$run" --by code --outfit shortlong --prior gmm --seed 4
make poses vary "$run" --by pose --motion squats --codes seed:4
make shapes vary "$run" --by shape --outfit shortshort --codes frame:276
make directions vary "$run" --by direction --outfit shortlong --rows 3 --columns 5
make between vary "$run" --by between --codes frame:0,frame:300
make effect eval pose "$run" --pose-a a-pose --pose-b squats --scale 4
make redressed redress "$run" frame:276 --pose squats
make given redress "$run" frame:276 --to 2,-1 --to -2,1 --to frame:200
make scanned fit scan "$run" --scan redressed/0-registration.ply --outfit shortshort --free-displacement
make squats animate "$run" --motion squats --seed 4 --seconds 2 --fps 12 --size 256
"$examples/texture" "$run"
"$examples/picture"

for name in outfits codes poses shapes directions between; do
    cp "$name/variations.png" "$pictures/$name.png"
done
cp effect/pose_effect.png "$pictures/effect.png"
cp redressed/redress.png "$pictures/redressed.png"
cp given/redress.png "$pictures/given.png"
cp scanned/fit.png "$pictures/scan.png"
cp squats/animation.png "$pictures/squats.png"
cp texture.png picture.png "$pictures"
cp demo/contact_sheet.png "$pictures"
cp demo/built_in.png "$pictures/built-in.png"
