//! Effects that couple all pixels: what load the array's way out has to bear.
//!
//! How long an event waits depends on the events of all pixels before it, and what a pixel fires later
//! depends on how long it waited. So the whole array is simulated without waiting first; the effects are
//! given what it fired ([`Camera::inform`]); the pixels whose waits that changes are simulated again; and so
//! on until no wait changes. An event's wait depends on earlier events only, so each pass makes at least one
//! more event of every pixel right, and at a moderate load nearly all.
//!
//! The load is every event that a pixel fires: also what is lost later on
//! ([`photocurrent_sensor::effects::event_loss`] loses behind the queue, its pixel has waited and reset), and
//! what leaves after the recording's end.
//!
//! To the nanosecond, since an event that moves by less would find itself in the load, just before it, and
//! wait behind itself.
//!
//! Limit: after [`PASSES`] passes the last one counts, and a note says how many pixels still moved. A readout
//! that stays overloaded may need more.

use super::camera::Camera;
use super::pixel_light::PixelLight;
use photocurrent_core::{Context, Light, NodeError, Rows};
use photocurrent_sensor::effects::{ArrayEvent, Kernel, PixelEvent};
use rayon::prelude::*;

/// Passes after the first; each is over the pixels that still move, which soon are few.
const PASSES: usize = 64;

/// An event with the delay that it was simulated with.
#[derive(Clone, Copy)]
struct Asked {
    event: PixelEvent,
    delay_ns: i64,
}

/// What the pixels of a row fire.
type RowAsked = Vec<Vec<Asked>>;

/// Informs the camera's effects of the load that the array has with them. Does nothing for a camera whose
/// pixels are on their own; otherwise `light` covers the sensor, and is read in blocks of `block_rows`.
///
/// # Errors
/// When the light cannot be read or is not positive, or the user interrupts.
pub(super) fn settle(
    camera: &mut Camera,
    kernel: Option<&Kernel>,
    light: &Light,
    block_rows: u32,
    cx: &Context,
) -> Result<(), NodeError> {
    if camera.couples().is_none() {
        return Ok(());
    }
    let extent = light.meta.extent;
    let mut array: Vec<RowAsked> = vec![vec![Vec::new(); extent.width as usize]; extent.height as usize];
    fire(camera, kernel, light, block_rows, &mut array, |_, _, _| true, cx)?;
    let mut moved = 0;
    for _ in 0..PASSES {
        camera.inform(&load(&array));
        let camera = &*camera;
        let is_moved = |x, y, asked: &[Asked]| {
            asked.iter().any(|asked| camera.delay_ns(x, y, asked.event.t_in_ns) != asked.delay_ns)
        };
        moved = fire(camera, kernel, light, block_rows, &mut array, is_moved, cx)?;
        if moved == 0 {
            return Ok(());
        }
    }
    cx.count(
        moved,
        &format!(
            "pixels still moved in the last of {PASSES} passes over the load: the readout \
                              is near overload, and their waits are approximate"
        ),
    );
    Ok(())
}

/// Simulates the pixels that `is_wanted` picks by column, row and what they fired before; gives back how
/// many.
fn fire(
    camera: &Camera,
    kernel: Option<&Kernel>,
    light: &Light,
    block_rows: u32,
    array: &mut [RowAsked],
    is_wanted: impl Fn(u32, u32, &[Asked]) -> bool + Sync,
    cx: &Context,
) -> Result<u64, NodeError> {
    let extent = light.meta.extent;
    let columns = |y: u32, row: &RowAsked| -> Vec<u32> {
        (0..extent.width).filter(|&x| is_wanted(x, y, &row[x as usize])).collect()
    };
    let wanted: Vec<Vec<u32>> =
        array.par_iter().zip(0..extent.height).map(|(row, y)| columns(y, row)).collect();
    let rows_to_do = wanted.iter().filter(|columns| !columns.is_empty()).count();
    if rows_to_do == 0 {
        return Ok(0);
    }
    cx.begin(rows_to_do as u64, "rows");
    for block in extent.rows().bands(block_rows) {
        let inside = block.start as usize..block.end as usize;
        if wanted[inside.clone()].iter().all(Vec::is_empty) {
            continue;
        }
        let light = light.read(block.with_halo(camera.halo(), extent.rows()))?;
        let fire_row = |(y, (row, columns)): (u32, (&mut RowAsked, &Vec<u32>))| -> Result<(), NodeError> {
            let mut pixel = PixelLight::default();
            for &x in columns {
                pixel.take(&light, extent, kernel, x, y);
                let fired = camera.fired(x, y, &pixel.seen()?);
                let asked = fired.iter().map(|fired| Asked {
                    event: fired.event,
                    delay_ns: camera.delay_ns(x, y, fired.event.t_in_ns),
                });
                row[x as usize] = asked.collect();
            }
            if columns.is_empty() { Ok(()) } else { cx.advance(1) }
        };
        let Rows { start, end } = block;
        (start..end)
            .into_par_iter()
            .zip(array[inside.clone()].par_iter_mut().zip(&wanted[inside]))
            .try_for_each(fire_row)?;
    }
    Ok(wanted.iter().map(|columns| columns.len() as u64).sum())
}

/// The events of the whole array in order of true off-pixel time.
fn load(array: &[RowAsked]) -> Vec<ArrayEvent> {
    let rows = (0u32..).zip(array);
    let pixels = rows.flat_map(|(y, row)| (0u32..).zip(row).map(move |(x, pixel)| (x, y, pixel)));
    let mut load: Vec<ArrayEvent> = pixels
        .flat_map(|(x, y, pixel)| pixel.iter().map(move |asked| ArrayEvent { x, y, event: asked.event }))
        .collect();
    load.par_sort_unstable_by_key(|asked| (asked.event.t_off_ns, asked.event.t_in_ns, asked.y, asked.x));
    load
}
