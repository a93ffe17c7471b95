// A pixel's chain without derivatives: what an answer costs.

// What a walk sums up.
struct Cost {
    place: Place,
    prior: f32,
}

fn offsets_cost(p: Place) -> f32 {
    var cost = 0.0;
    if pixel.reference_variance > 0.0 {
        cost = p.reference * p.reference / pixel.reference_variance;
    }
    if pixel.threshold_variance > 0.0 {
        cost += (p.on * p.on + p.off * p.off) / pixel.threshold_variance;
    }
    return cost;
}

// What the expectation of thresholds subtracts.
fn pulled(p: Place) -> f32 {
    if pixel.threshold_variance > 0.0 {
        return 2.0 * (state.expected_on * p.on + state.expected_off * p.off) / pixel.threshold_variance;
    }
    return 0.0;
}

fn no_event_cost(sigma: f32, square: f32) -> f32 {
    if sigma > 0.0 {
        return square / (sigma * sigma);
    }
    return 0.0;
}

// Goes along the light of now, moved by `share` of its change where `moves_light`: that light is then written
// to the other column, with its energies. `at` is where it begins, with its offsets. The prior's cost
// is at the scales of the light of now.
fn walk(at: Place, moves_light: bool, share: f32) -> Cost {
    var chain = begin_chain(at.u0, at.reference);
    var cost = Cost(at, 0.0);
    cost.place.measured = 0.0;
    cost.place.no_event_square = 0.0;
    cost.place.event_square = 0.0;
    cost.place.frame_square = 0.0;
    cost.place.largest = 0.0;
    cost.place.largest_step = 0u;
    cost.place.events = 0u;
    cost.place.frames = 0u;
    var along = begin_along();
    var energy = vec2(0.0, 0.0);
    let on = pixel.on + at.on;
    let off = pixel.off + at.off;
    let column = state.column;
    let other = 1u - column;
    if moves_light {
        set_work(ENERGY + 2u * other, 0u, 0.0);
        set_work(ENERGY + 2u * other + 1u, 0u, 0.0);
    }
    for (var s = 0u; s < pixel.steps; s++) {
        let what = whats[cell(s)];
        if (what & SEGMENT) != 0u && s > 0u {
            let length_s = given_at(LENGTH, s);
            let old = work_at(column, s);
            var w = old;
            var e = Expected(0.0, 1.0, 1.0);
            if moves_light {
                w = old + share * work_at(CHANGE, s);
                if abs(chain.u + w) > LOG_LIMIT {
                    w = clamp(chain.u + w, -LOG_LIMIT, LOG_LIMIT) - chain.u;
                }
                set_work(other, s, w);
                let part = two_sum(energy.x, w * w / length_s);
                energy = vec2(part.x, energy.y + part.y);
                e = go_along(&along, s, length_s, old, w);
            }
            advance(&chain, s, w, length_s, e);
        }
        if moves_light {
            set_work(ENERGY + 2u * other, s, energy.x);
            set_work(ENERGY + 2u * other + 1u, s, energy.y);
        }
        let seen = sight(chain, what, s, on, off);
        let square = seen.residual * seen.residual / seen.variance;
        if (seen.what & EVENT) != 0u {
            cost.place.event_square += square;
            cost.place.events += 1u;
        } else if (seen.what & FRAME) != 0u {
            cost.place.frame_square += square;
            cost.place.frames += 1u;
        } else if (seen.what & NO_EVENT) != 0u {
            cost.place.no_event_square += seen.residual * seen.residual;
        }
        if (seen.what & (EVENT | FRAME)) != 0u && square > cost.place.largest {
            cost.place.largest = square;
            cost.place.largest_step = s;
        }
        turn(&chain, what, s, on, off);
    }
    cost.place.measured = cost.place.event_square + cost.place.frame_square + offsets_cost(at);
    cost.prior = along.cost;
    return cost;
}

// Energies of the light of now, in its column.
fn add_energies() {
    var energy = vec2(0.0, 0.0);
    for (var s = 0u; s < pixel.steps; s++) {
        if (whats[cell(s)] & SEGMENT) != 0u && s > 0u {
            let w = work_at(state.column, s);
            let part = two_sum(energy.x, w * w / given_at(LENGTH, s));
            energy = vec2(part.x, energy.y + part.y);
        }
        set_work(ENERGY + 2u * state.column, s, energy.x);
        set_work(ENERGY + 2u * state.column + 1u, s, energy.y);
    }
}

// The start, as what lies before the first step.
fn to_start() {
    state.here.u0 = pixel.start;
    state.here.reference = 0.0;
    state.here.on = 0.0;
    state.here.off = 0.0;
    for (var s = 0u; s < pixel.steps; s++) {
        set_work(state.column, s, given_at(START, s));
    }
    add_energies();
}

fn measure() {
    state.here = walk(state.here, false, 0.0).place;
}

// The pixel's misfit: squares of all that it measured.
fn misfit(p: Place) -> f32 {
    return p.measured + no_event_cost(pixel.no_event_sigma, p.no_event_square);
}
