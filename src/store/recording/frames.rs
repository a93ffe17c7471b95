//! Frames and true frames of a recording: the header checked at once, the numbers read lazily.

use super::checked::{check_column, group_integer, has_group, required};
use crate::error::{Mistakes, StoreError};
use crate::hdf::Opened;
use crate::hdf::grid::{Grid, number_type};
use photocurrent_core::frames::FrameSource;
use photocurrent_core::{Colour, DataError, Exposure, Extent, FrameBlock, Rows, Timestamp};
use std::ops::Range;
use std::sync::Arc;

/// Memory for unpacked chunks: recorders like one frame per chunk, and a row band touches them all.
const KEPT_BYTES: usize = 128 << 20;

/// The frames of a recording.
pub(super) struct Frames {
    pub exposures: Vec<Exposure>,
    pub row_time_ns: Option<i64>,
    pub colour: Colour,
    pub dn: Arc<Numbers>,
}

/// Digital numbers as they are stored.
enum Stored {
    F32(Grid<f32>),
    U16(Grid<u16>),
}

/// Digital numbers, read as f32.
pub(super) struct Numbers {
    stored: Stored,
    pub count: usize,
    pub channels: usize,
    /// Size of the pictures: the events' extent or a whole multiple of it.
    pub extent: Extent,
    rank: usize,
}

impl Numbers {
    pub(super) fn number_type(&self) -> &'static str {
        match self.stored {
            Stored::F32(_) => "f32",
            Stored::U16(_) => "u16",
        }
    }

    fn open(
        opened: &Opened,
        name: &str,
        events: Option<Extent>,
        u16_allowed: bool,
    ) -> Result<Numbers, StoreError> {
        let at = format!("/{name}");
        let found = number_type(opened, name)?.map(|kind| kind.to_string());
        let stored = match found.as_deref() {
            Some("uint16") if u16_allowed => {
                Stored::U16(required::<u16>(opened, name, None)?.keeping(KEPT_BYTES))
            }
            Some("float32") | None => Stored::F32(required::<f32>(opened, name, None)?.keeping(KEPT_BYTES)),
            Some(found) => {
                let expected = if u16_allowed { "float32 or uint16" } else { "float32" };
                return Err(opened.content(
                    &at,
                    format!("numbers of type {found}"),
                    expected,
                    "write the frames as linear digital numbers of that type",
                ));
            }
        };
        let shape = match &stored {
            Stored::F32(grid) => &grid.shape,
            Stored::U16(grid) => &grid.shape,
        };
        let rank = shape.len();
        if !(rank == 3 || rank == 4) {
            let expected = "[frames, height, width] or [frames, height, width, channels]";
            return Err(opened.content(
                &at,
                format!("the shape {shape:?}"),
                expected,
                "write all frames as one dataset",
            ));
        }
        let (height, width, channels) = (shape[1], shape[2], shape.get(3).copied().unwrap_or(1));
        let side = |pixels: usize| u32::try_from(pixels).unwrap_or(u32::MAX);
        let extent = Extent { width: side(width), height: side(height) };
        if let Some(events) = events.filter(|events| extent.multiple_of(*events).is_none()) {
            let expected = format!(
                "{events}, as the attributes say, or a whole multiple of it (the same for width and height)"
            );
            let hint = "crop or bin the frames to the pixels of the event sensor";
            return Err(opened.content(&at, format!("frames of {width} x {height} pixels"), expected, hint));
        }
        if channels == 0 {
            return Err(opened.content(
                &at,
                "no channel at all",
                "at least one",
                "leave the last dimension out for grey frames",
            ));
        }
        let count = shape[0];
        Ok(Numbers { stored, count, channels, extent, rank })
    }

    fn block(&self, frames: Range<usize>, rows: Rows) -> Result<FrameBlock, StoreError> {
        let start = [frames.start, rows.start as usize, 0, 0];
        let width = self.extent.width as usize;
        let count = [frames.len(), rows.len(), width, self.channels];
        let dn = match &self.stored {
            Stored::F32(grid) => grid.read(&start[..self.rank], &count[..self.rank])?,
            // Every u16 is exact in f32.
            Stored::U16(grid) => {
                grid.read(&start[..self.rank], &count[..self.rank])?.into_iter().map(f32::from).collect()
            }
        };
        Ok(FrameBlock { frames, rows, row_values: width * self.channels, dn })
    }
}

impl FrameSource for Numbers {
    fn read(&self, frames: Range<usize>, rows: Rows) -> Result<FrameBlock, DataError> {
        Ok(self.block(frames, rows)?)
    }
}

impl Frames {
    pub(super) fn open(opened: &Opened, extent: Option<Extent>) -> Result<Option<Frames>, StoreError> {
        if !has_group(opened, "frames") {
            return Ok(None);
        }
        let mut mistakes = Mistakes::default();
        let dn = mistakes.take(Numbers::open(opened, "frames/dn", extent, true));
        let colour = dn.as_ref().and_then(|dn| mistakes.take(colour_of(opened, "frames", dn)));
        let mut stamps = |name: &str| mistakes.take(stamps(opened, name, dn.as_ref(), "/frames/dn"));
        let (start, end) = (stamps("frames/exposure_start"), stamps("frames/exposure_end"));
        if let Some((start, end)) =
            start.as_ref().zip(end.as_ref()).filter(|(start, end)| start.len() == end.len())
        {
            mistakes.take(check_exposures(opened, start, end));
        }
        let row_time_ns = mistakes.take(group_integer(opened, "frames", "row_time_ns")).flatten();
        mistakes.finish(&opened.path)?;
        let (Some(dn), Some(colour), Some(start), Some(end)) = (dn, colour, start, end) else {
            return Ok(None);
        };
        let exposures: Vec<Exposure> = start
            .iter()
            .zip(&end)
            .map(|(&start, &end)| Exposure { start: Timestamp(start), end: Timestamp(end) })
            .collect();
        Ok(Some(Frames { exposures, row_time_ns, colour, dn: Arc::new(dn) }))
    }
}

/// One stamp for each picture of `dn`; of any number when that could not be read.
fn stamps(opened: &Opened, name: &str, dn: Option<&Numbers>, like: &str) -> Result<Vec<i64>, StoreError> {
    let grid = required::<i64>(opened, name, Some("ns"))?;
    let count = dn.map_or(grid.shape.first().copied().unwrap_or(0), |dn| dn.count);
    check_column(opened, name, &grid, count, like)?;
    grid.column(0..count)
}

/// The colours that the attribute `colour` of a group names, held against the channels of its `dn`.
fn colour_of(opened: &Opened, group: &str, dn: &Numbers) -> Result<Colour, StoreError> {
    let at = format!("/{group}");
    let name = match opened.group(group)? {
        Some(found) => opened.text_attribute(&found, &at, "colour")?,
        None => None,
    };
    let name = name.unwrap_or_else(|| Colour::Mono.name().into());
    let unknown = || {
        let names: Vec<&str> = Colour::names().collect();
        opened.content(
            &format!("{at}: attribute `colour`"),
            format!("\"{name}\""),
            names.join(", "),
            "name the mosaic by its upper left cell, row by row",
        )
    };
    let colour = Colour::named(&name).ok_or_else(unknown)?;
    if dn.channels != colour.channels() as usize {
        let hint = "set `colour` to \"rgb\" for three channels; a mosaic has one channel";
        let expected = format!("{} for colour = \"{colour}\"", colour.channels());
        return Err(opened.content(&format!("{at}/dn"), format!("{} channels", dn.channels), expected, hint));
    }
    Ok(colour)
}

fn check_exposures(opened: &Opened, start: &[i64], end: &[i64]) -> Result<(), StoreError> {
    let mut mistakes = Mistakes::default();
    let empty: Vec<usize> = (0..start.len()).filter(|&l| end[l] <= start[l]).collect();
    if let Some(&l) = empty.first() {
        let found = format!(
            "an empty exposure in {} of {} frames, first in frame {l} ({} to {} ns)",
            empty.len(),
            start.len(),
            start[l],
            end[l]
        );
        let hint = "were the two datasets swapped, or is the unit not ns?";
        mistakes.take::<()>(Err(opened.content(
            "/frames/exposure_end",
            found,
            "exposure_end > exposure_start",
            hint,
        )));
    }
    if let Some(l) = (1..start.len()).find(|&l| start[l] < start[l - 1]) {
        let found =
            format!("frame {l} starting at {} ns, before frame {} at {} ns", start[l], l - 1, start[l - 1]);
        mistakes.take::<()>(Err(opened.content(
            "/frames/exposure_start",
            found,
            "frames in time order",
            "sort the frames by the start of their exposure",
        )));
    }
    mistakes.finish(&opened.path)
}

/// The true frames of simulated data.
pub(super) struct TruthFrames {
    pub times: Vec<Timestamp>,
    pub colour: Colour,
    pub dn: Arc<Numbers>,
}

impl TruthFrames {
    pub(super) fn open(opened: &Opened, extent: Option<Extent>) -> Result<Option<TruthFrames>, StoreError> {
        if !has_group(opened, "truth") {
            return Ok(None);
        }
        let mut mistakes = Mistakes::default();
        let dn = mistakes.take(Numbers::open(opened, "truth/dn", extent, false));
        let colour = dn.as_ref().and_then(|dn| mistakes.take(colour_of(opened, "truth", dn)));
        let times = mistakes.take(
            stamps(opened, "truth/t", dn.as_ref(), "/truth/dn").and_then(|times| in_order(opened, times)),
        );
        mistakes.finish(&opened.path)?;
        let (Some(dn), Some(colour), Some(times)) = (dn, colour, times) else { return Ok(None) };
        Ok(Some(TruthFrames { times: times.into_iter().map(Timestamp).collect(), colour, dn: Arc::new(dn) }))
    }
}

/// The instants of true frames, which do not decrease.
fn in_order(opened: &Opened, times: Vec<i64>) -> Result<Vec<i64>, StoreError> {
    if let Some(m) = (1..times.len()).find(|&m| times[m] < times[m - 1]) {
        let found =
            format!("instant {m} at {} ns, before instant {} at {} ns", times[m], m - 1, times[m - 1]);
        return Err(opened.content(
            "/truth/t",
            found,
            "instants in time order",
            "sort the true frames by time",
        ));
    }
    Ok(times)
}
