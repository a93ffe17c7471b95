// Gauss-Newton steps: one attempt of every pixel in a call. `group/passes.rs` and `group/lane.rs` of
// photocurrent-sensor have the algebra.

// Linearises at the light of now and filters forward; gives the prior's cost.
fn forward() -> f32 {
    var f = begin_states();
    var chain = begin_chain(state.here.u0, state.here.reference);
    var along = begin_along();
    let on = pixel.on + state.here.on;
    let off = pixel.off + state.here.off;
    for (var s = 0u; s < pixel.steps; s++) {
        let what = whats[cell(s)] & 0xffffu;
        let seen = arrive(&f, &chain, &along, s, on, off);
        if seen.what != 0u {
            keep_gain(see(&f, seen), s);
        }
        turn(&chain, what, s, on, off);
        turn_states(&f, what);
        if (what & LAST) != 0u {
            if state.damping > 0.0 {
                damp(&f, s);
            }
            keep_row(&f, s);
        }
    }
    return along.cost;
}

fn damp(f: ptr<function, Filtered>, s: u32) {
    var cross: array<REAL, $N>;
#each a in 0..N
    cross[$a] = (*f).p[I$a$U];
#end
    let weight = take(f, cross, cross[$U] + 1.0 / state.damping, -(*f).x[$U]);
    let at = cell(s);
#each a in 0..N
    dampings[$au * params.cells + at] = weight.gain[$a];
#end
    dampings[$Nu * params.cells + at] = weight.pull;
}

// Of the way back: the longest change of log light, whether all are numbers, and how unknowns of the whole
// pixel change. Changes of the increments go to their column.
struct Back {
    longest: f32,
    is_finite: bool,
    u0: f32,
    reference: f32,
    on: f32,
    off: f32,
}

fn backward() -> Back {
    var lambda: array<f32, $N>;
    var back = Back(0.0, true, 0.0, 0.0, 0.0, 0.0);
    var moved = 0.0;
    var pending = 0u;
    var has_pending = false;
    for (var k = pixel.steps; k > 0u; k--) {
        let s = k - 1u;
        let at = cell(s);
        let what = whats[at];
        if (what & LAST) != 0u {
            var own = rows[$Nu * params.cells + at];
#each a in 0..N
            own += rows[$au * params.cells + at] * lambda[$a];
#end
            if has_pending {
                set_work(CHANGE, pending, moved - own);
            }
            moved = own;
            back.longest = max(back.longest, abs(own));
            back.is_finite = back.is_finite && is_finite(own);
            if state.damping > 0.0 {
                var pull = dampings[$Nu * params.cells + at];
#each a in 0..N
                pull -= dampings[$au * params.cells + at] * lambda[$a];
#end
                lambda[$U] += pull;
            }
        }
        if (what & SEGMENT) != 0u {
            pending = s;
            has_pending = true;
        }
        if (what & LATCH) != 0u {
            lambda[$V] += lambda[$R];
            lambda[$R] = 0.0;
        }
        if (what & EXPOSE) != 0u {
            lambda[$S] = 0.0;
        }
#if free
        if (what & MOVE) != 0u {
            if (what & RISE) != 0u {
                lambda[$ON] += lambda[$R];
            } else {
                lambda[$OFF] -= lambda[$R];
            }
        }
#end
        let seen = what >> 16u;
        if seen != 0u {
            var pull = gains[$Nu * params.cells + at];
#each a in 0..N
            pull -= gains[$au * params.cells + at] * lambda[$a];
#end
            if (seen & FRAME) != 0u {
                lambda[$S] += pull;
            } else {
                lambda[$V] += pull;
                lambda[$R] -= pull;
#if free
                if (seen & RISE) != 0u {
                    lambda[$ON] -= pull;
                } else {
                    lambda[$OFF] += pull;
                }
#end
            }
        }
        if (what & SEGMENT) != 0u && s > 0u {
            let c = transposed(kept_move(s), array<f32, 4>(lambda[0], lambda[1], lambda[2], lambda[3]));
            lambda[0] = c[0];
            lambda[1] = c[1];
            lambda[2] = c[2];
        }
    }
    back.u0 = moved;
    let first = begin_states();
    var voltage = first.x[$V];
    var reference = first.x[$R];
#each a in 0..N
    voltage += first.p[I$V$a] * lambda[$a];
    reference += first.p[I$R$a] * lambda[$a];
#end
    back.reference = reference - voltage;
#if free
    back.on = first.x[$ON];
    back.off = first.x[$OFF];
#each a in 0..N
    back.on += first.p[I$ON$a] * lambda[$a];
    back.off += first.p[I$OFF$a] * lambda[$a];
#end
#end
    return back;
}

#if free
fn prior_cost() -> f32 {
    var along = begin_along();
    for (var s = 1u; s < pixel.steps; s++) {
        if (whats[cell(s)] & SEGMENT) != 0u {
            let w = work_at(state.column, s);
            go_along(&along, s, given_at(LENGTH, s), w, w);
        }
    }
    return along.cost;
}

// `thresholds::expected` of photocurrent-sensor.
fn expect_thresholds() {
    let way = pixel.rising * abs(pixel.on + state.here.on) + pixel.falling * abs(pixel.off + state.here.off);
    var per_event = 0.0;
    if way > 0.0 {
        per_event = pixel.threshold_variance * prior_cost() / way;
    }
    state.expected_on = per_event * pixel.rising;
    state.expected_off = per_event * pixel.falling;
}
#end

fn stop(status: u32) {
    state.here.status = status;
    state.is_stepping = 0u;
}

fn attempt(most: u32) {
    let is_new = state.attempts == 0u;
    if is_new {
        state.here.iterations += 1u;
        if state.here.iterations == NO_EVENT_FROM {
            state.here.no_event_sigma = pixel.no_event_sigma;
        }
#if free
        expect_thresholds();
#end
    }
    let prior = forward();
    if is_new {
        state.cost = state.here.measured + prior
            + no_event_cost(state.here.no_event_sigma, state.here.no_event_square) - pulled(state.here);
        if !is_finite(state.cost) {
            stop(FAILED);
            return;
        }
    }
    let back = backward();
    var is_better = false;
    if back.is_finite {
        let share = min(1.0, LONGEST_STEP / back.longest);
        var to = state.here;
        to.u0 = clamp(to.u0 + share * back.u0, -LOG_LIMIT, LOG_LIMIT);
        to.reference += share * back.reference;
        to.on += share * back.on;
        to.off += share * back.off;
        let cost = walk(to, true, share);
        let total = cost.place.measured + cost.prior
            + no_event_cost(to.no_event_sigma, cost.place.no_event_square) - pulled(to);
        // A step at the level of rounding may go up by rounding.
        is_better = is_finite(total) && total <= state.cost * (1.0 + ROUNDING) + ROUNDING;
        if is_better {
            state.here = cost.place;
            state.column = 1u - state.column;
        }
    }
    if !is_better {
        state.damping = max(state.damping * 10.0, FIRST_DAMPING);
        state.attempts += 1u;
        if state.attempts == ATTEMPTS {
            stop(select(FAILED, UNFINISHED, state.here.iterations > 1u));
        }
        return;
    }
    state.damping = select(0.0, state.damping * 0.1, state.damping > FIRST_DAMPING);
    state.attempts = 0u;
    if back.longest < pixel.tolerance {
        stop(CONVERGED);
    } else if state.here.iterations == most {
        state.is_stepping = 0u;
    }
}

// As before the first step, with the light and the offsets that there are.
fn begin_stage(stage: u32, event: f32, most: u32) {
    state.stage = stage;
    state.event = event;
    state.is_stepping = select(0u, 1u, most > 0u);
    state.attempts = 0u;
    state.damping = 0.0;
    state.here.no_event_sigma = 0.0;
    state.here.iterations = 0u;
    state.here.status = UNFINISHED;
    state.expected_on = 0.0;
    state.expected_off = 0.0;
    measure();
}

// `SecondStart::is_worth_a_try`.
fn is_worth_a_try() -> bool {
    let p = state.here;
    let is_amiss = p.event_square > pixel.least_misfit * f32(p.events)
        && misfit(p) < pixel.most_misfit * pixel.measured;
    return pixel.second_steps > 0u && pixel.alpha_s > 0.0 && (p.status == FAILED || is_amiss);
}

// What comes after the last step of a stage.
fn next_stage() {
    if state.stage == 0u {
        if is_worth_a_try() {
            state.plain = state.here;
            for (var s = 0u; s < pixel.steps; s++) {
                set_work(SAVED, s, work_at(state.column, s));
            }
            to_start();
            begin_stage(1u, max(pixel.event, pixel.second_event), pixel.second_steps);
            return;
        }
    } else if state.stage == 1u {
        begin_stage(2u, pixel.event, pixel.second_steps);
        return;
    } else if state.here.status != FAILED
        && (state.plain.status == FAILED || misfit(state.here) < pixel.second_keeps * misfit(state.plain)) {
        state.here.iterations += state.plain.iterations;
        state.second = KEPT;
    } else {
        state.second = REFUSED;
        state.here = state.plain;
        for (var s = 0u; s < pixel.steps; s++) {
            set_work(state.column, s, work_at(SAVED, s));
        }
        add_energies();
        measure();
    }
    state.stage = 3u;
}

@compute @workgroup_size(64)
fn begin(@builtin(global_invocation_id) id: vec3<u32>) {
    let n = params.first + id.x;
    if n >= params.end {
        return;
    }
    pixel = pixels[n];
    to_start();
    begin_stage(0u, pixel.event, pixel.max_iterations);
    if state.is_stepping == 0u {
        next_stage();
    }
    states[n] = state;
}

@compute @workgroup_size(64)
fn descend(@builtin(global_invocation_id) id: vec3<u32>) {
    let n = params.first + id.x;
    if n >= params.end || states[n].is_stepping == 0u {
        return;
    }
    pixel = pixels[n];
    state = states[n];
    attempt(select(pixel.second_steps, pixel.max_iterations, state.stage == 0u));
    if state.is_stepping == 0u {
        next_stage();
    }
    states[n] = state;
    if state.is_stepping != 0u {
        atomicAdd(&left, 1u);
    }
}
