// Means of light over exposures: `exposure.rs` of photocurrent-sensor, in single precision, with instants of
// 64 bits, the low half first. A thread has some exposures of a pixel, one after the other.

@group(0) @binding(0) var<uniform> call: MeansCall;
@group(0) @binding(1) var<storage, read> offsets: array<u32>;
// Which row a pixel is in.
@group(0) @binding(2) var<storage, read> row_of: array<u32>;
@group(0) @binding(3) var<storage, read> times: array<vec2<u32>>;
@group(0) @binding(4) var<storage, read> light: array<f32>;
@group(0) @binding(5) var<storage, read> sigma: array<f32>;
// By row: start and end.
@group(0) @binding(6) var<storage, read> exposures: array<vec4<u32>>;
// By exposure: bits of a number a pixel, of light, then of spread.
@group(0) @binding(7) var<storage, read_write> means: array<u32>;

const UNKNOWN = 0x7fc00000u;
// What a photocurrent of zero counts as.
const DARKEST = 1.2e-38;
const LOG_DARKEST = -87.49823;

fn is_before(a: vec2<u32>, b: vec2<u32>) -> bool {
    if a.y != b.y {
        return bitcast<i32>(a.y) < bitcast<i32>(b.y);
    }
    return a.x < b.x;
}

fn earlier(a: vec2<u32>, b: vec2<u32>) -> vec2<u32> {
    if is_before(b, a) {
        return b;
    }
    return a;
}

// From `a` to `b`, which is not before it, ns.
fn duration(a: vec2<u32>, b: vec2<u32>) -> f32 {
    let high = b.y - a.y - select(0u, 1u, b.x < a.x);
    return f32(high) * 4294967296.0 + f32(b.x - a.x);
}

fn value(k: u32, is_spread: bool) -> f32 {
    if is_spread {
        return light[k] * sigma[k];
    }
    return light[k];
}

fn log_of(x: f32) -> f32 {
    if x < DARKEST {
        return LOG_DARKEST;
    }
    return log(x);
}

// (1 - e^-x) / x of a number that is not negative.
fn fallen(x: f32) -> f32 {
    if x < 0.3 {
        return 1.0 - x * (0.5 - x * (1.0 / 6.0 - x * (1.0 / 24.0 - x * (1.0 / 120.0 - x * (1.0 / 720.0 - x / 5040.0)))));
    }
    return (1.0 - exp(-x)) / x;
}

// x e^-by, whose factors may be out of range where it is not.
fn faded(x: f32, by: f32) -> f32 {
    if by < 40.0 {
        return x * exp(-by);
    }
    return exp(log_of(x) - by);
}

// The mean between `since` and `to`, which lie between knots k and k + 1. It is taken from the brighter end
// on, so that no exponential grows.
fn log_linear(k: u32, since: vec2<u32>, to: vec2<u32>, is_spread: bool) -> f32 {
    let here = value(k, is_spread);
    let there = value(k + 1u, is_spread);
    let slope = (log_of(there) - log_of(here)) / duration(times[k], times[k + 1u]);
    let steep = abs(slope);
    let shape = fallen(steep * duration(since, to));
    if slope > 0.0 {
        return faded(there, steep * duration(to, times[k + 1u])) * shape;
    }
    return faded(here, steep * duration(times[k], since)) * shape;
}

// `holding` is the last knot not after the start, or the first.
fn mean(first: u32, last: u32, holding: u32, start: vec2<u32>, end: vec2<u32>, is_spread: bool) -> f32 {
    var sum = 0.0;
    var now = start;
    if is_before(now, times[first]) {
        let to = earlier(times[first], end);
        sum += value(first, is_spread) * duration(now, to);
        now = to;
    }
    for (var k = holding; k < last && is_before(now, end); k++) {
        let to = earlier(times[k + 1u], end);
        if is_before(now, to) {
            if is_spread || call.is_linear != 0u {
                sum += log_linear(k, now, to, is_spread) * duration(now, to);
            } else {
                sum += light[k] * duration(now, to);
            }
            now = to;
        }
    }
    if is_before(now, end) {
        sum += value(last, is_spread) * duration(now, end);
    }
    return sum / duration(start, end);
}

@compute @workgroup_size(64)
fn integrate(@builtin(global_invocation_id) id: vec3<u32>) {
    let pixel = id.x;
    if pixel >= call.pixels {
        return;
    }
    let begin = id.y * call.piece;
    let end = min(begin + call.piece, call.exposures);
    let first = offsets[pixel];
    let past = offsets[pixel + 1u];
    let of_row = row_of[pixel] * call.exposures;
    if first == past {
        for (var n = begin; n < end; n++) {
            means[n * call.pixels + pixel] = UNKNOWN;
            if call.with_spread != 0u {
                means[(call.exposures + n) * call.pixels + pixel] = UNKNOWN;
            }
        }
        return;
    }
    let last = past - 1u;
    // The last knot not after the first exposure's start, by halves.
    let begins = exposures[of_row + begin].xy;
    var holding = first;
    var beyond = past;
    while beyond - holding > 1u {
        let middle = holding + (beyond - holding) / 2u;
        if is_before(begins, times[middle]) {
            beyond = middle;
        } else {
            holding = middle;
        }
    }
    for (var n = begin; n < end; n++) {
        let exposure = exposures[of_row + n];
        while holding < last && !is_before(exposure.xy, times[holding + 1u]) {
            holding++;
        }
        while holding > first && is_before(exposure.xy, times[holding]) {
            holding--;
        }
        let collected = mean(first, last, holding, exposure.xy, exposure.zw, false);
        means[n * call.pixels + pixel] = bitcast<u32>(collected);
        if call.with_spread != 0u {
            let spread = mean(first, last, holding, exposure.xy, exposure.zw, true);
            means[(call.exposures + n) * call.pixels + pixel] = bitcast<u32>(spread);
        }
    }
}
