//! Pixels whose event paths share photocurrent: what the events of each are known to be beyond their
//! thresholds, given the estimates of its neighbours.
//!
//! Every pixel is solved alone first. Then, in rounds, what each event pixel sees of the estimates around it
//! says how far its events are from what the stated sensor would have made of the pixel's own estimate
//! ([`photocurrent_sensor::undo::Undo::at_light`]), and all are solved again. The last solution is left to
//! the caller, who chooses settings anew for it.
//!
//! Limits: a round leaves of an error what the kernel takes from it, so that detail of single pixels under a
//! wide blur or a shift by half a pixel is corrected in part; pixels whose event pixel would lie beyond the
//! array are known by their frames alone, and so is what their neighbours see of them.
//!
//! A round reaches as many rows as the kernel, and settings are chosen by blocks of rows, so a band needs the
//! rounds' reach and a block more on each side ([`halo`]): bands and threads change no bit.
//!
//! Where frames have several values on an event pixel, every value's problem is posed in that event pixel's
//! photocurrent: neighbours are then the values at the same place of their own event pixels.

use crate::co_located::CoLocated;
use crate::host::Host;
use crate::model::Model;
use crate::options::SolveOptions;
use crate::row::{KnownOfRows, Recorded};
use crate::row_solver::{RowLight, RowSolver};
use crate::settings::{BLOCK_ROWS, Settings};
use photocurrent_core::{NodeError, Rows};
use photocurrent_sensor::conditional::at_each;
use photocurrent_sensor::map::PixelEvent;
use photocurrent_sensor::mixing::Mixing;
use photocurrent_sensor::undo::{Estimate, Known, Memory};
use rayon::prelude::*;

/// Rows of frames above and below those asked for that must be at hand; none where no photocurrent is mixed.
pub fn halo(model: &Model, lie: CoLocated) -> Option<u32> {
    let mixing = model.undo.mixing()?;
    let in_rows = |event_rows: u32| event_rows.saturating_mul(lie.ratio);
    let rounds = in_rows(mixing.reach()).saturating_mul(model.undo_rounds);
    // The rest of the own block, the rounds, the rest of the block where they end, and one for the company of
    // events.
    Some(
        rounds
            .saturating_add(in_rows(mixing.rows_down().unsigned_abs()))
            .saturating_add(2 * (BLOCK_ROWS - 1) + 1),
    )
}

/// What is known of the events of `rows` and the rest of their blocks; none where no photocurrent is mixed.
///
/// # Errors
/// When the recording does not fit itself, or the user interrupts.
pub fn known(
    params: &SolveOptions,
    model: &Model,
    recorded: &Recorded<'_>,
    rows: Rows,
    host: &dyn Host,
) -> Result<Option<KnownOfRows>, NodeError> {
    let Some(mixing) = model.undo.mixing() else { return Ok(None) };
    let (all, lie) = (recorded.meta.extent.rows(), recorded.colours.lie);
    let wanted = Settings::blocks_of(rows, all);
    let reach = mixing.reach().saturating_mul(lie.ratio);
    let rows_of = |rounds_to_come: u32| wanted.with_halo(reach.saturating_mul(rounds_to_come), all);
    let settings = Settings::choose(params, model, recorded, rows_of(model.undo_rounds), None)?;
    let mut known: Option<KnownOfRows> = None;
    for rounds_to_come in (0..model.undo_rounds).rev() {
        let at_hand = rows_of(rounds_to_come + 1);
        let light = |solver: &mut RowSolver, row: u32| -> Result<RowLight, NodeError> {
            solver.take(model, settings.of(row), recorded, row)?;
            if let Some(known) = &known {
                solver.give(known.of(row).to_vec());
            }
            // Rounds are no rows of the result: they only look whether the user interrupts.
            host.advance(0)?;
            Ok(solver.light(model, settings.of(row), recorded.meta))
        };
        let lights: Result<Vec<RowLight>, NodeError> =
            at_hand.iter().into_par_iter().map_init(RowSolver::default, light).collect();
        let lights = lights?;
        let of_row = |row: u32| &lights[(row - at_hand.start) as usize];
        let again = |(solver, memory): &mut (RowSolver, Memory), row: u32| -> Result<Vec<Known>, NodeError> {
            solver.take(model, settings.of(row), recorded, row)?;
            host.advance(0)?;
            Ok(known_of_row(model, mixing, settings.of(row).options.spacing_ns, solver, row, &of_row, memory))
        };
        let inner = rows_of(rounds_to_come);
        let of_rows: Result<Vec<Vec<Known>>, NodeError> =
            inner.iter().into_par_iter().map_init(Default::default, again).collect();
        known = Some(KnownOfRows { first: inner.start, of_rows: of_rows? });
    }
    Ok(known)
}

/// What is known of the events of a row that was taken in, at the lights of its neighbours.
fn known_of_row<'a>(
    model: &Model,
    mixing: &Mixing,
    spacing_ns: i64,
    solver: &RowSolver,
    row: u32,
    of_row: &impl Fn(u32) -> &'a RowLight,
    memory: &mut Memory,
) -> Vec<Known> {
    let data = solver.data();
    let (mut instants, mut own) = (Vec::new(), Vec::new());
    let of_value = |x: usize| {
        let events = data.events_of(x);
        let mut known = Known { events: events.to_vec(), ..Known::default() };
        let (t_ns, log) = of_row(row).of(x);
        if !data.has_event_pixel(x) || t_ns.is_empty() || of_row(row).has_failed(x) {
            return known;
        }
        let (site, recorded): (_, &[PixelEvent]) = data.recorded_of(x);
        // Neighbours change where the pixel itself has no knots.
        refined(t_ns, spacing_ns, &mut instants);
        own.clear();
        at_each(t_ns, log, &instants, &mut own);
        let seen =
            mixing.seen((site.x, site.y), (site.width, site.height), instants.len(), |column, line, out| {
                let (x, row) = data.same_place(x, (column, line));
                let (t_ns, log) = of_row(row).of(x);
                // A neighbour without a frame is as bright as the pixel.
                if t_ns.is_empty() { out.extend_from_slice(&own) } else { at_each(t_ns, log, &instants, out) }
            });
        let light = Estimate { t_ns: &instants, own: &own, seen: Some(&seen) };
        model.undo.at_light(&model.sensor, &site, light, recorded, events, &mut known, memory);
        known
    };
    (0..data.width()).map(of_value).collect()
}

/// Instants with others between, at most `spacing_ns` apart.
fn refined(t_ns: &[i64], spacing_ns: i64, out: &mut Vec<i64>) {
    out.clear();
    out.extend(t_ns.first());
    for pair in t_ns.windows(2) {
        let (from, length) = (pair[0], pair[1] - pair[0]);
        let pieces = (length + spacing_ns - 1) / spacing_ns;
        out.extend(
            (1..=pieces)
                .map(|piece| from + (i128::from(length) * i128::from(piece) / i128::from(pieces)) as i64),
        );
    }
}
