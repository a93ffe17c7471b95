// The last pass: evidence and posterior variances of log light, in REAL. `group/variance.rs` and
// `curvature.rs` of photocurrent-sensor have the algebra.

// Filters forward at the answer; gives the evidence.
fn forward() -> f32 {
    var f = begin_states();
    var chain = begin_chain(state.here.u0, state.here.reference);
    var along = begin_along();
    let on = pixel.on + state.here.on;
    let off = pixel.off + state.here.off;
    var sum = 0.0;
    for (var s = 0u; s < pixel.steps; s++) {
        let what = whats[cell(s)] & 0xffffu;
        let seen = arrive(&f, &chain, &along, s, on, off);
        if seen.what != 0u {
            // `take` gives the pull, innovation times information.
            let weight = see(&f, seen);
            let information = low(weight.information);
            let pull = low(weight.pull);
            keep_gain(weight, s);
            set_work(CHANGE, s, information);
            if (seen.what & (EVENT | FRAME)) != 0u {
                sum += LOG_TWO_PI - log(information) + pull * pull / information;
            }
        }
        turn(&chain, what, s, on, off);
        turn_states(&f, what);
        if (what & LAST) != 0u {
            keep_row(&f, s);
        }
    }
    return -0.5 * sum;
}

// The curvature of all later measurements by the states.
var<private> q: array<REAL, $HALF>;

fn untake(what: u32, information: f32, s: u32) {
    let at = cell(s);
#each a in 0..N
    let gain_$a = lift(gains[$au * params.cells + at]);
#end
    var both = lift(information);
#each a in 0..N
    var along_$a = lift(0.0);
#each b in 0..N
    along_$a = mad(q[I$a$b], gain_$b, along_$a);
#end
    both = mad(along_$a, gain_$a, both);
#end
    if (what & FRAME) != 0u {
#each a in 0..N
        q[I$a$S] = sub(q[I$a$S], along_$a);
#end
        q[I$S$S] = add(sub(q[I$S$S], along_$S), both);
        return;
    }
#if free
    let rises = (what & RISE) != 0u;
    // What was looked at, but for voltage and reference, whose parts are 1 and -1.
    let of_on = select(0.0, -1.0, rises);
    let of_off = select(1.0, 0.0, rises);
#end
#each a in 0..N
    var h_$a = lift(0.0);
#end
    h_$V = lift(1.0);
    h_$R = lift(-1.0);
#if free
    h_$ON = lift(of_on);
    h_$OFF = lift(of_off);
#end
#each a in 0..N
#each b in a..N
    q[I$a$b] = add(q[I$a$b], sub(mul(sub(mul(both, h_$a), along_$a), h_$b), mul(h_$a, along_$b)));
#end
#end
}

fn unpredict(m: Move) {
    // Columns first, then rows, which are columns of the transpose.
#each a in 0..N
    let half_$a = transposed(m, array<REAL, 4>(q[I$a0], q[I$a1], q[I$a2], q[I$a3]));
#end
#each b in 0..4
    let column_$b = transposed(m, array<REAL, 4>(half_0[$b], half_1[$b], half_2[$b], half_3[$b]));
#end
#each a in 0..4
#each b in a..4
    q[I$a$b] = column_$b[$a];
#end
#each b in 4..N
    q[I$a$b] = half_$b[$a];
#end
#end
}

// Column and row `to` grow by those of `of`; the reference's curvature follows a state that it was set by.
fn turn_back(what: u32) {
    if (what & LATCH) != 0u {
        q[I$V$V] = add(q[I$V$V], add(add(q[I$V$R], q[I$V$R]), q[I$R$R]));
#each a in 0..N
        q[I$a$V] = select_real(add(q[I$a$V], q[I$a$R]), q[I$a$V], $au == $Vu);
#end
#each a in 0..N
        q[I$a$R] = lift(0.0);
#end
    }
    if (what & EXPOSE) != 0u {
#each a in 0..N
        q[I$a$S] = lift(0.0);
#end
    }
#if free
    if (what & MOVE) != 0u {
        if (what & RISE) != 0u {
            q[I$ON$ON] = add(q[I$ON$ON], add(add(q[I$ON$R], q[I$ON$R]), q[I$R$R]));
#each a in 0..N
            q[I$a$ON] = select_real(add(q[I$a$ON], q[I$a$R]), q[I$a$ON], $au == $ONu);
#end
        } else {
            q[I$OFF$OFF] = add(q[I$OFF$OFF], sub(q[I$R$R], add(q[I$OFF$R], q[I$OFF$R])));
#each a in 0..N
            q[I$a$OFF] = select_real(sub(q[I$a$OFF], q[I$a$R]), q[I$a$OFF], $au == $OFFu);
#end
        }
    }
#end
}

fn select_real(no: REAL, yes: REAL, chosen: bool) -> REAL {
    if chosen {
        return yes;
    }
    return no;
}

fn backward() {
#each a in 0..N
#each b in a..N
    q[I$a$b] = lift(0.0);
#end
#end
    for (var k = pixel.steps; k > 0u; k--) {
        let s = k - 1u;
        let what = whats[cell(s)];
        // The variance takes its place.
        let information = work_at(CHANGE, s);
        if (what & LAST) != 0u {
            let at = cell(s);
#each a in 0..N
            let row_$a = lift(rows[$au * params.cells + at]);
#end
            var variance = row_0;
#each a in 0..N
            var along_$a = lift(0.0);
#each b in 0..N
            along_$a = mad(q[I$a$b], row_$b, along_$a);
#end
            variance = sub(variance, mul(row_$a, along_$a));
#end
            set_work(CHANGE, s, max(low(variance), 0.0));
        }
        turn_back(what);
        let seen = what >> 16u;
        if seen != 0u {
            untake(seen, information, s);
        }
        if (what & SEGMENT) != 0u && s > 0u {
            unpredict(kept_move(s));
        }
    }
}

// An answer that failed, or whose light is implausible, becomes the start.
fn fall_back() {
    var u = state.here.u0;
    var most = u;
    for (var s = 1u; s < pixel.steps; s++) {
        if (whats[cell(s)] & SEGMENT) != 0u {
            u += work_at(state.column, s);
            most = max(most, u);
        }
    }
    if state.here.status == FAILED || most > pixel.limit || !is_finite(most) {
        state.here.status = FAILED;
        to_start();
        measure();
    }
}

@compute @workgroup_size(64)
fn last(@builtin(global_invocation_id) id: vec3<u32>) {
    let n = params.first + id.x;
    if n >= params.end {
        return;
    }
    pixel = pixels[n];
    state = states[n];
    fall_back();
    state.expected_on = 0.0;
    state.expected_off = 0.0;
    if params.with_evidence != 0u {
        state.evidence = forward();
    }
    if params.with_variance != 0u {
        backward();
    }
    for (var s = 0u; s < pixel.steps; s++) {
        set_work(SAVED, s, work_at(state.column, s));
    }
    states[n] = state;
}
