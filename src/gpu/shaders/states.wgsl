// Changes of the states and their covariance (the half above the diagonal), in REAL: `State` of
// photocurrent-sensor.

struct Filtered {
    x: array<REAL, $N>,
    p: array<REAL, $HALF>,
}

struct Weight {
    gain: array<REAL, $N>,
    pull: REAL,
    information: REAL,
}

fn begin_states() -> Filtered {
    var f: Filtered;
#each a in 0..N
    f.x[$a] = lift(0.0);
#each b in a..N
    f.p[I$a$b] = lift(0.0);
#end
#end
    let change = lift(pixel.start - state.here.u0);
    f.x[$U] = change;
    f.x[$V] = change;
    f.x[$R] = sub(change, lift(state.here.reference));
    f.p[I$U$U] = lift(FIRST_VARIANCE);
    f.p[I$U$V] = lift(FIRST_VARIANCE);
    f.p[I$U$R] = lift(FIRST_VARIANCE);
    f.p[I$V$V] = lift(FIRST_VARIANCE);
    f.p[I$V$R] = lift(FIRST_VARIANCE);
    f.p[I$R$R] = add(lift(FIRST_VARIANCE), lift(pixel.reference_variance));
    f.p[I$Z$Z] = lift(1.0);
#if free
    f.x[$ON] = lift(state.expected_on - state.here.on);
    f.x[$OFF] = lift(state.expected_off - state.here.off);
    f.p[I$ON$ON] = lift(pixel.threshold_variance);
    f.p[I$OFF$OFF] = lift(pixel.threshold_variance);
#end
    return f;
}

// Log light, z, voltage and collected light over a segment.
fn apply(m: Move, c: array<REAL, 4>) -> array<REAL, 4> {
    return array<REAL, 4>(
        mad(lift(m.u_by_z), c[1], c[0]),
        mul(lift(m.correlation), c[1]),
        mad(lift(m.voltage), c[2], mad(lift(m.v_by_u), c[0], mul(lift(m.v_by_z), c[1]))),
        add(c[3], mad(lift(m.s_by_u), c[0], mul(lift(m.s_by_z), c[1]))),
    );
}

fn predict(f: ptr<function, Filtered>, m: Move, fresh: f32, surprise: f32) {
    let by_new = array<REAL, 4>(lift(m.u_by_new), lift(1.0), lift(m.v_by_new), lift(m.s_by_new));
    let x = apply(m, array<REAL, 4>((*f).x[0], (*f).x[1], (*f).x[2], (*f).x[3]));
#each a in 0..4
    (*f).x[$a] = mad(by_new[$a], lift(surprise), x[$a]);
#end
#each b in 4..N
    let column_$b = apply(m, array<REAL, 4>((*f).p[I0$b], (*f).p[I1$b], (*f).p[I2$b], (*f).p[I3$b]));
#each a in 0..4
    (*f).p[I$a$b] = column_$b[$a];
#end
#end
#each b in 0..4
    let half_$b = apply(m, array<REAL, 4>((*f).p[I0$b], (*f).p[I1$b], (*f).p[I2$b], (*f).p[I3$b]));
#end
#each a in 0..4
    let row_$a = apply(m, array<REAL, 4>(half_0[$a], half_1[$a], half_2[$a], half_3[$a]));
    let new_$a = mul(by_new[$a], lift(fresh));
#each b in a..4
    (*f).p[I$a$b] = mad(new_$a, by_new[$b], row_$a[$b]);
#end
#end
}

fn take(f: ptr<function, Filtered>, cross: array<REAL, $N>, spread: REAL, innovation: REAL) -> Weight {
    var weight: Weight;
    weight.information = reciprocal(spread);
    weight.pull = mul(innovation, weight.information);
#each a in 0..N
    weight.gain[$a] = mul(cross[$a], weight.information);
    (*f).x[$a] = mad(cross[$a], weight.pull, (*f).x[$a]);
#each b in a..N
    (*f).p[I$a$b] = sub((*f).p[I$a$b], mul(weight.gain[$a], cross[$b]));
#end
#end
    return weight;
}

// Takes in what counts at a step.
fn see(f: ptr<function, Filtered>, seen: Sight) -> Weight {
    var cross: array<REAL, $N>;
    if (seen.what & FRAME) != 0u {
#each a in 0..N
        cross[$a] = (*f).p[I$a$S];
#end
        let innovation = sub(lift(seen.residual), (*f).x[$S]);
        return take(f, cross, add(cross[$S], lift(seen.variance)), innovation);
    }
#each a in 0..N
    cross[$a] = sub((*f).p[I$a$V], (*f).p[I$a$R]);
#end
    var predicted = sub((*f).x[$V], (*f).x[$R]);
#if free
    let rises = (seen.what & RISE) != 0u;
    if rises {
        predicted = sub(predicted, (*f).x[$ON]);
#each a in 0..N
        cross[$a] = sub(cross[$a], (*f).p[I$a$ON]);
#end
    } else {
        predicted = add(predicted, (*f).x[$OFF]);
#each a in 0..N
        cross[$a] = add(cross[$a], (*f).p[I$a$OFF]);
#end
    }
#end
    var spread = sub(cross[$V], cross[$R]);
#if free
    if rises {
        spread = sub(spread, cross[$ON]);
    } else {
        spread = add(spread, cross[$OFF]);
    }
#end
    return take(f, cross, add(spread, lift(seen.variance)), sub(lift(seen.residual), predicted));
}

// What happens after the measurement of a step.
fn turn_states(f: ptr<function, Filtered>, what: u32) {
#if free
    if (what & MOVE) != 0u {
        if (what & RISE) != 0u {
            (*f).x[$R] = add((*f).x[$R], (*f).x[$ON]);
            let twice = add((*f).p[I$R$ON], (*f).p[I$R$ON]);
            (*f).p[I$R$R] = add((*f).p[I$R$R], add(twice, (*f).p[I$ON$ON]));
#each a in 0..4
            (*f).p[I$a$R] = add((*f).p[I$a$R], (*f).p[I$a$ON]);
#end
            (*f).p[I$ON$R] = add((*f).p[I$ON$R], (*f).p[I$ON$ON]);
            (*f).p[I$OFF$R] = add((*f).p[I$OFF$R], (*f).p[I$OFF$ON]);
        } else {
            (*f).x[$R] = sub((*f).x[$R], (*f).x[$OFF]);
            let twice = add((*f).p[I$R$OFF], (*f).p[I$R$OFF]);
            (*f).p[I$R$R] = add(sub((*f).p[I$R$R], twice), (*f).p[I$OFF$OFF]);
#each a in 0..4
            (*f).p[I$a$R] = sub((*f).p[I$a$R], (*f).p[I$a$OFF]);
#end
            (*f).p[I$ON$R] = sub((*f).p[I$ON$R], (*f).p[I$ON$OFF]);
            (*f).p[I$OFF$R] = sub((*f).p[I$OFF$R], (*f).p[I$OFF$OFF]);
        }
    }
#end
    if (what & EXPOSE) != 0u {
        (*f).x[$S] = lift(0.0);
#each a in 0..N
        (*f).p[I$a$S] = lift(0.0);
#end
    }
    if (what & LATCH) != 0u {
        (*f).x[$R] = (*f).x[$V];
        (*f).p[I$R$R] = (*f).p[I$V$V];
#each a in 0..4
        (*f).p[I$a$R] = (*f).p[I$a$V];
#end
#if free
        (*f).p[I$ON$R] = (*f).p[I$ON$V];
        (*f).p[I$OFF$R] = (*f).p[I$OFF$V];
#end
    }
}

// What is kept of a step for the way back.
fn keep_move(m: Move, s: u32) {
    let at = cell(s);
    moves[at] = m.correlation;
    moves[params.cells + at] = m.u_by_z;
    moves[2u * params.cells + at] = m.voltage;
    moves[3u * params.cells + at] = m.v_by_u;
    moves[4u * params.cells + at] = m.v_by_z;
    moves[5u * params.cells + at] = m.s_by_u;
    moves[6u * params.cells + at] = m.s_by_z;
}

fn kept_move(s: u32) -> Move {
    let at = cell(s);
    return Move(
        moves[at],
        moves[params.cells + at],
        moves[2u * params.cells + at],
        moves[3u * params.cells + at],
        moves[4u * params.cells + at],
        moves[5u * params.cells + at],
        moves[6u * params.cells + at],
        0.0,
        0.0,
        0.0,
    );
}

fn keep_row(f: ptr<function, Filtered>, s: u32) {
    let at = cell(s);
#each a in 0..N
    rows[$au * params.cells + at] = low((*f).p[I$U$a]);
#end
    rows[$Nu * params.cells + at] = low((*f).x[$U]);
}

fn keep_gain(weight: Weight, s: u32) {
    let at = cell(s);
#each a in 0..N
    gains[$au * params.cells + at] = low(weight.gain[$a]);
#end
    gains[$Nu * params.cells + at] = low(weight.pull);
}

// `F' x`.
fn transposed(m: Move, c: array<REAL, 4>) -> array<REAL, 4> {
    return array<REAL, 4>(
        add(c[0], mad(lift(m.v_by_u), c[2], mul(lift(m.s_by_u), c[3]))),
        add(
            mad(lift(m.correlation), c[1], mul(lift(m.u_by_z), c[0])),
            mad(lift(m.v_by_z), c[2], mul(lift(m.s_by_z), c[3])),
        ),
        mul(lift(m.voltage), c[2]),
        c[3],
    );
}

// Predicts to a step and finds what counts there, at the light of now; what is seen stands at the step as well.
fn arrive(
    f: ptr<function, Filtered>,
    chain: ptr<function, Chain>,
    along: ptr<function, Along>,
    s: u32,
    on: f32,
    off: f32,
) -> Sight {
    let what = whats[cell(s)] & 0xffffu;
    if (what & SEGMENT) != 0u && s > 0u {
        let length_s = given_at(LENGTH, s);
        let w = work_at(state.column, s);
        let e = go_along(along, s, length_s, w, w);
        let move_ = advance(chain, s, w, length_s, e);
        predict(f, move_, e.fresh, -(*along).surprise);
        keep_move(move_, s);
    }
    var seen = sight(*chain, what, s, on, off);
    if (seen.what & NO_EVENT) != 0u && state.here.no_event_sigma == 0.0 {
        seen.what = 0u;
    }
    whats[cell(s)] = what | (seen.what << 16u);
    return seen;
}
