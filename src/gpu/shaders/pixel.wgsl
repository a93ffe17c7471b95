// What a pixel is given, where it stands, and the chain of light, voltage and collected light.
//
// Unknowns are increments of log light; voltages are kept as differences from light and from the reference:
// nothing large is subtracted, which is what makes single precision enough.

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> pixels: array<Pixel>;
@group(0) @binding(2) var<storage, read_write> states: array<State>;
@group(0) @binding(3) var<storage, read> given: array<u32>;
// What is at a step, and above 16 bits what of it counted.
@group(0) @binding(4) var<storage, read_write> whats: array<u32>;
@group(0) @binding(5) var<storage, read_write> work: array<f32>;
@group(0) @binding(6) var<storage, read_write> gains: array<f32>;
@group(0) @binding(7) var<storage, read_write> rows: array<f32>;
@group(0) @binding(8) var<storage, read_write> moves: array<f32>;
@group(0) @binding(9) var<storage, read_write> dampings: array<f32>;
// Pixels that still step.
@group(0) @binding(10) var<storage, read_write> left: atomic<u32>;

var<private> pixel: Pixel;
var<private> state: State;

// Pixels of a group stand side by side.
fn cell(s: u32) -> u32 {
    return pixel.cell + s * LANES;
}

fn given_at(column: u32, s: u32) -> f32 {
    return bitcast<f32>(given[column * params.cells + cell(s)]);
}

fn work_at(column: u32, s: u32) -> f32 {
    return work[column * params.cells + cell(s)];
}

fn set_work(column: u32, s: u32, value: f32) {
    work[column * params.cells + cell(s)] = value;
}

fn is_finite(value: f32) -> bool {
    return (bitcast<u32>(value) & 0x7f800000u) != 0x7f800000u;
}

// `value`, but compilers cannot see that: sums of rounding errors are not simplified away.
fn opaque(value: f32) -> f32 {
    return bitcast<f32>(bitcast<u32>(value) ^ params.zero);
}

// Sum and rounding error of a sum.
fn two_sum(a: f32, b: f32) -> vec2<f32> {
    let sum = opaque(a + b);
    let of_b = opaque(sum - a);
    return vec2(sum, (a - opaque(sum - of_b)) + (b - of_b));
}

fn exp_m1(x: f32) -> f32 {
    if abs(x) < 0.35 {
        return x * (1.0 + x * (1.0 / 2.0) * (1.0 + x * (1.0 / 3.0) * (1.0 + x * (1.0 / 4.0)
            * (1.0 + x * (1.0 / 5.0) * (1.0 + x * (1.0 / 6.0) * (1.0 + x * (1.0 / 7.0)))))));
    }
    return exp(x) - 1.0;
}

// The chain at a step: log light, root of the photocurrent, voltage less log light, voltage less reference,
// light collected.
struct Chain {
    u: f32,
    root: f32,
    gap: f32,
    change: f32,
    light: f32,
}

fn begin_chain(u0: f32, reference: f32) -> Chain {
    return Chain(u0, exp(0.5 * u0), 0.0, -reference, 0.0);
}

// `fill_pieces` of photocurrent-sensor.
struct Piece {
    left: f32,
    lag: f32,
    through_gap: f32,
    through_rise: f32,
    light: f32,
    light_by_last: f32,
}

// Rises below this are short; single precision loses digits sooner than double precision does.
const SHORT_RISE: f32 = 0.1;
const TAU_FLOOR_S: f32 = 1e-30;

fn piece(length_s: f32, rise: f32, from_root: f32, to_root: f32) -> Piece {
    var piece: Piece;
    let middle = from_root * to_root;
    let one_over_tau = 1.0 / max(pixel.tau_0_s * middle + pixel.alpha_s, TAU_FLOOR_S * middle);
    let lengths = length_s * (middle * one_over_tau);
    let by_tau = -0.5 * (pixel.alpha_s * one_over_tau);
    let is_short = abs(rise) < SHORT_RISE;
    let divisor = select(rise, 1.0, is_short);
    let one_over = 1.0 / (lengths * divisor);
    let settled = -exp_m1(-lengths);
    piece.left = 1.0 - settled;
    piece.lag = settled * (divisor * one_over);
    piece.through_gap = by_tau * piece.left * lengths;
    piece.through_rise = by_tau * (piece.left - piece.lag) * rise;
    let per_rise = lengths * one_over;
    let from_light = from_root * from_root;
    let to_light = to_root * to_root;
    let series = 1.0 + rise * (0.5 + rise * (1.0 / 6.0 + rise * (1.0 / 24.0
        + rise * (1.0 / 120.0 + rise * (1.0 / 720.0)))));
    let series_by_last = 0.5 + rise * (1.0 / 3.0 + rise * (1.0 / 8.0 + rise * (1.0 / 30.0
        + rise * (1.0 / 144.0 + rise * (1.0 / 840.0)))));
    let mean = (to_light - from_light) * per_rise;
    piece.light = length_s * select(mean, from_light * series, is_short);
    let by_last = (to_light - mean) * per_rise;
    piece.light_by_last = length_s * select(by_last, from_light * series_by_last, is_short);
    return piece;
}

// The map of one segment and what is new in it; `Transition` of photocurrent-sensor.
struct Move {
    correlation: f32,
    u_by_z: f32,
    voltage: f32,
    v_by_u: f32,
    v_by_z: f32,
    s_by_u: f32,
    s_by_z: f32,
    u_by_new: f32,
    v_by_new: f32,
    s_by_new: f32,
}

// Takes the chain over the segment that ends at step s.
fn advance(chain: ptr<function, Chain>, s: u32, w: f32, length_s: f32, expected: Expected) -> Move {
    let from_root = (*chain).root;
    (*chain).u += w;
    (*chain).root = exp(0.5 * (*chain).u);
    let p = piece(length_s, w, from_root, (*chain).root);
    let gap = (*chain).gap;
    let through = p.through_gap * gap + p.through_rise;
    let follows = 1.0 - p.lag;
    let settled = 1.0 - p.left;
    (*chain).change += follows * w - settled * gap;
    (*chain).gap = p.left * gap - p.lag * w;
    let exposure = given_at(EXPOSURE, s);
    let light_by_last = exposure * p.light_by_last;
    (*chain).light += exposure * p.light;
    let by_last = follows + through;
    let u_by_z = expected.scale * expected.correlation;
    return Move(
        expected.correlation,
        u_by_z,
        p.left,
        settled + 2.0 * through,
        by_last * u_by_z,
        exposure * p.light,
        light_by_last * u_by_z,
        expected.scale,
        by_last * expected.scale,
        light_by_last * expected.scale,
    );
}

// What happens after the measurement of a step.
fn turn(chain: ptr<function, Chain>, what: u32, s: u32, on: f32, off: f32) {
    if (what & EXPOSE) != 0u {
        (*chain).light = 0.0;
    }
    if (what & MOVE) != 0u {
        (*chain).change -= select(-off, on, (what & RISE) != 0u) + given_at(TARGET, s);
    }
    if (what & LATCH) != 0u {
        (*chain).change = 0.0;
    }
}

// What is measured at a step and counts, what it misses by, and its variance.
struct Sight {
    what: u32,
    residual: f32,
    variance: f32,
}

fn sight(chain: Chain, what: u32, s: u32, on: f32, off: f32) -> Sight {
    if (what & EVENT) != 0u {
        let rises = (what & RISE) != 0u;
        let sigma = state.event * select(pixel.off, pixel.on, rises);
        var variance = sigma * sigma;
        if pixel.stamp_sigma_s > 0.0 {
            let current = chain.root * chain.root;
            let tau_light = pixel.tau_0_s * current + pixel.alpha_s;
            if tau_light > 0.0 {
                let stamp = chain.gap * current / tau_light * pixel.stamp_sigma_s;
                variance += stamp * stamp;
            }
        }
        let level = select(-off, on, rises) + given_at(TARGET, s);
        return Sight(what & (EVENT | RISE), level - chain.change, variance);
    }
    if (what & FRAME) != 0u {
        let dark = given_at(TARGET, s) - chain.light;
        return Sight(select(FRAME, 0u, (what & BOUND) != 0u && dark < 0.0), dark, 1.0);
    }
    if (what & NO_EVENT) != 0u {
        let variance = pixel.no_event_sigma * pixel.no_event_sigma;
        if chain.change > on {
            return Sight(NO_EVENT | RISE, on - chain.change, variance);
        }
        if chain.change < -off {
            return Sight(NO_EVENT, -off - chain.change, variance);
        }
    }
    return Sight(0u, 0.0, 1.0);
}

// The prior of the segment that ends at a step.
struct Expected {
    correlation: f32,
    fresh: f32,
    scale: f32,
}

// `before_s` is the length of the segment before, 0 for the first; `slope` its slope.
fn expected(s: u32, length_s: f32, before_s: f32, w: f32, slope: f32) -> Expected {
    let apart_s = 0.5 * (length_s + before_s);
    let is_first = before_s == 0.0;
#if local
    let distance = apart_s / pixel.tails;
    let near = given[NEAR * params.cells + cell(s)];
    let high = s + (near & 0xffffu);
    let low = s - (near >> 16u);
    let column = ENERGY + 2u * state.column;
    let between = (work_at(column, high) - work_at(column, low))
        + (work_at(column + 1u, high) - work_at(column + 1u, low));
    let mean_square = max(between, 0.0) * given_at(PER_NEARBY, s);
    return Expected(
        select(exp(-distance), 0.0, is_first),
        select(-exp_m1(-2.0 * distance), 1.0, is_first),
        given_at(REACH, s) * sqrt(pixel.spread + mean_square),
    );
#end
#if walk
    return Expected(0.0, 1.0, sqrt((pixel.spread * length_s + w * w) / pixel.tails));
#end
#if integrated
    let change = w / length_s - slope;
    let fresh = (pixel.spread * apart_s + change * change) / pixel.tails;
    return Expected(select(1.0, 0.0, is_first), select(fresh, FIRST_SLOPE_VARIANCE, is_first), length_s);
#end
}

// The prior along a pixel's segments.
struct Along {
    before_s: f32,
    slope: f32,
    z: f32,
    cost: f32,
    surprise: f32,
}

fn begin_along() -> Along {
    return Along(0.0, 0.0, 0.0, 0.0, 0.0);
}

// The prior of the next segment, at scales of the increment `w`; `moved` is the increment that it judges.
fn go_along(along: ptr<function, Along>, s: u32, length_s: f32, w: f32, moved: f32) -> Expected {
    let e = expected(s, length_s, (*along).before_s, w, (*along).slope);
    (*along).before_s = length_s;
    (*along).slope = w / length_s;
    let z = moved / e.scale;
    (*along).surprise = z - e.correlation * (*along).z;
    (*along).z = z;
    (*along).cost += (*along).surprise * (*along).surprise / e.fresh;
    return e;
}
