#!/bin/bash
# For the minutes in which a graphics card is lent: is it right, and how quick is it? Prints one table.
#
#   src/gpu/lent.sh                                  1280 x 720, 100 ms, then 2 s in blocks
#   src/gpu/lent.sh --size 64x48 --long 0            small, without the long recording: lavapipe in minutes
#   src/gpu/lent.sh --prebuilt out/lent              where nothing can be built: `--pack out/lent` filled it
#
# Options:
#   --size WxH          pixels of the recording (1280x720)
#   --long SECONDS      length of the long recording; 0 = none (2)
#   --pixels N          pixels of the inner loop (921600, or those of the size where it is smaller)
#   --profile NAME      how the program is built: release or dev (release)
#   --pack FOLDER       build, put programs and libraries that a bare machine lacks there, and end
#   --prebuilt FOLDER   take them from there and build nothing
#   --out FOLDER        logs, and results while it runs; what lies there is replaced (out/lent-run)
#   --noise VALUE       noise of events, stated: nothing is chosen then, which is the processor's part (chosen)
#   --scale FACTOR      all time limits times this: a slow machine needs more (1)
#
# Every step has its own time limit; together they are 675 s with the program built before. A step that fails or runs out of time is a row of the table, and the others go on.
set -u
cd "$(dirname "$0")/../.." || exit 2

size=1280x720 long=2 pixels= profile=release pack= prebuilt= out=out/lent-run scale=1 noise=
while [ $# -gt 0 ]; do
    [ $# -ge 2 ] || { echo "$1 needs a value" >&2; exit 2; }
    case $1 in
        --size) size=$2 ;;
        --long) long=$2 ;;
        --pixels) pixels=$2 ;;
        --profile) profile=$2 ;;
        --pack) pack=$2 ;;
        --prebuilt) prebuilt=$2 ;;
        --out) out=$2 ;;
        --noise) noise=$2 ;;
        --scale) scale=$2 ;;
        *) echo "unknown: $1; the head of this file has the options" >&2; exit 2 ;;
    esac
    shift 2
done
width=${size%x*} height=${size#*x}
case $width$height$scale$long in *[!0-9.]*) echo "--size WxH, --long and --scale are numbers" >&2; exit 2 ;; esac
[ -n "$pixels" ] || pixels=$((width * height < 921600 ? width * height : 921600))
rm -rf "$out"
mkdir -p "$out"
rows=$out/table.md

# row WHAT VALUE: a row of the table, shown at once.
row() { echo "| $1 | $2 |" | tee -a "$rows"; }

# step NAME SECONDS COMMAND...: runs it with a time limit; its output goes to NAME.log, its time to `took`.
step() {
    local name=$1 limit=$2 begun ended
    shift 2
    limit=$(awk "BEGIN { print int($limit * $scale + 0.5) }")
    begun=$(date +%s.%N)
    timeout --kill-after=5 "$limit" "$@" >"$out/$name.log" 2>&1
    code=$?
    ended=$(date +%s.%N)
    took=$(awk "BEGIN { printf \"%.2f\", $ended - $begun }")
    case $code in
        0) return 0 ;;
        124 | 137) row "$name" "not done in $limit s" ;;
        *) row "$name" "failed: $(grep -m1 -i 'error\|panicked' "$out/$name.log" | tr '|' '/' | cut -c1-200)" ;;
    esac
    return 1
}

echo "| step | result |" >"$rows"
echo "| --- | --- |" >>"$rows"
cat "$rows"

# (a) What is there.
row machine "$(nproc) cores, $(awk '/MemTotal/ { printf "%.0f GB", $2 * 1024e-9 }' /proc/meminfo) of memory, $(df -Pk . | awk 'NR == 2 { printf "%.0f GB", $4 * 1024e-9 }') of disk free"
if command -v nvidia-smi >/dev/null; then
    row card "$(nvidia-smi --query-gpu=name,driver_version,memory.total --format=csv,noheader 2>&1 | head -1)"
else
    row card "no nvidia-smi"
fi
if [ -n "$prebuilt" ]; then
    [ -x "$prebuilt/photocurrent" ] || { row prerequisites "$prebuilt has no programs: fill it with --pack"; exit 1; }
    export LD_LIBRARY_PATH="$PWD/$prebuilt/lib${LD_LIBRARY_PATH:+:$LD_LIBRARY_PATH}"
else
    command -v cargo >/dev/null || { row prerequisites "no cargo: install Rust, or use --prebuilt"; exit 1; }
fi
drivers=$(ls /usr/share/vulkan/icd.d/*.json /etc/vulkan/icd.d/*.json 2>/dev/null | tr '\n' ' ')
loader=$(ldconfig -p 2>/dev/null | awk '/libvulkan.so.1/ { print $NF; exit }')
[ -z "$loader" ] && [ -n "$prebuilt" ] && loader=$(ls "$prebuilt/lib/libvulkan.so.1" 2>/dev/null)
vendor=$(ldconfig -p 2>/dev/null | awk '/libGLX_nvidia.so.0/ { print $NF; exit }')
case $drivers in
    *nvidia*) ;;
    *) if [ -n "$vendor" ] && [ -z "${VK_DRIVER_FILES:-}" ]; then
        # The driver is there and only its description is missing.
        printf '{ "file_format_version": "1.0.0", "ICD": { "library_path": "%s", "api_version": "1.3.0" } }\n' "$vendor" >"$out/nvidia.json"
        export VK_DRIVER_FILES="$PWD/$out/nvidia.json"
        drivers="$drivers$vendor (described here)"
    fi ;;
esac
row Vulkan "loader ${loader:-none}; drivers ${drivers:-none}"
# Drivers complain without it, and need it for nothing here.
export XDG_RUNTIME_DIR="${XDG_RUNTIME_DIR:-$PWD/$out}"
[ -n "$loader" ] || { row prerequisites "no Vulkan loader: install libvulkan1"; exit 1; }
[ -n "$drivers" ] || { row prerequisites "no Vulkan driver: install the card's, with its graphics part"; exit 1; }

# (b) The programs.
if [ -n "$prebuilt" ]; then
    program=$prebuilt/photocurrent tests=$prebuilt/card-tests bench=$prebuilt/card-bench
else
    flag=$([ "$profile" = dev ] || echo "--profile $profile")
    # shellcheck disable=SC2086
    step build 480 cargo build --workspace --features gpu --locked $flag --bin photocurrent || exit 1
    built=$took
    # The names of test programs have a hash: cargo states them.
    # shellcheck disable=SC2086
    step build-tests 480 cargo test --workspace --exclude photocurrent-diagnosis --features gpu --locked $flag --test card --bench card --no-run || exit 1
    row build "$built s, tests and inner loop $took s, profile $profile"
    folder=${CARGO_TARGET_DIR:-target}/$([ "$profile" = dev ] && echo debug || echo "$profile")
    program=$folder/photocurrent
    tests=$(sed -n 's/.*tests\/card\/main.rs (\(.*\))/\1/p' "$out/build-tests.log")
    bench=$(sed -n 's/.*benches\/card.rs (\(.*\))/\1/p' "$out/build-tests.log")
fi
if [ -n "$pack" ]; then
    mkdir -p "$pack/lib"
    cp "$program" "$pack/photocurrent" && cp "$tests" "$pack/card-tests" && cp "$bench" "$pack/card-bench" || exit 1
    strip "$pack/photocurrent" "$pack/card-tests" "$pack/card-bench"
    # What the program links beyond the C library, and the loader, which it opens.
    for library in $(ldd "$program" | awk '$3 ~ /^\// && $1 !~ /^lib(c|m|dl|rt|pthread|gcc_s)\./ { print $3 }') "$loader"; do
        cp -L "$library" "$pack/lib/"
    done
    [ -e "$pack/lib/libvulkan.so.1" ] || cp -L "$loader" "$pack/lib/libvulkan.so.1"
    row packed "$(du -sh "$pack" | cut -f1) in $pack"
    exit 0
fi

# (c) Is it right? Pixels against the processor's answers; no skipping.
export REQUIRE_GPU=1
step card-tests 60 "$tests" --nocapture && row "tests on the card" "$(grep -c '\.\.\. ok' "$out/card-tests.log") passed, $took s"
grep -h -o 'differ by [0-9.e-]* of their size at most\|pictures on the card differ .*' "$out/card-tests.log" | while read -r line; do row accuracy "$line"; done

# (d) How quickly it copies, and the inner loop.
if step inner-loop 30 "$bench" "$pixels"; then
    sed -n 1,9p "$out/inner-loop.log" | while read -r line; do row "inner loop" "$line"; done
fi

# run NAME LIMIT NODES...: some nodes of the pipeline; what lies in the cache is not done again.
set_size=(--set "nodes.scene.params.width=$width" --set "nodes.scene.params.height=$height")
if [ -n "$noise" ]; then
    for node in solve_card frames_card solve_here; do set_size+=(--set "nodes.$node.params.event_noise=$noise"); done
fi
run() {
    local name=$1 limit=$2 to=()
    shift 2
    for node in "$@"; do to+=(--to "$node"); done
    step "$name" "$limit" "$program" run src/gpu/lent.toml --cache "$out/cache" --out "$out/files" \
        "${set_size[@]}" "${to[@]}"
}
# timed NAME LIMIT WHAT NODES...: the same, as a row.
timed() {
    local name=$1 limit=$2 what=$3
    shift 3
    run "$name" "$limit" "$@" && row "$what" "$took s"
}

timed recording 40 "$size, 100 ms: recording simulated" recording
timed solve-card 30 "$size, 100 ms: solved on the card, tracks stored" solve_card
timed render-card 20 "$size, 100 ms: these rendered on the card at 1 kHz" render_card
timed frames-card 30 "$size, 100 ms: solved and rendered on the card, no tracks" frames_card
timed edi-card 10 "$size, 100 ms: EDI on the card" edi_card
timed solve-here 50 "$size, 100 ms: solved on the processor" solve_here
timed render-here 15 "$size, 100 ms: rendered on the processor" render_here
timed edi-here 10 "$size, 100 ms: EDI on the processor" edi_here

# (e) Pictures against the truth, by both.
for name in render_here render_card frames_card edi_here edi_card; do
    run "psnr-$name" 20 "psnr_$name" && row "PSNR, $name" \
        "$(grep -o '[0-9][0-9]*\.[0-9][0-9]* *dB\|psnr_db[^0-9]*[0-9.]*\|[0-9][0-9]*\.[0-9]\{3\}' "$out/psnr-$name.log" | tail -1)"
done

# (f) The long recording in blocks of 250 ms, end to end without tracks.
if [ "$long" != 0 ]; then
    set_size+=(--set "nodes.scene.params.duration=\"$long s\"" --set 'nodes.scene.params.texture={ speed = 0.6 }')
    set_size+=(--set 'pipeline.blocks={ length = "250 ms", overlap = "30 ms" }')
    timed long-recording 170 "$size, $long s: recording simulated" recording
    timed long-frames 80 "$size, $long s: solved and rendered on the card, in blocks" frames_card
fi
rm -rf "$out/cache" "$out/files"
echo
echo "The table is in $rows, with the logs of all steps."
