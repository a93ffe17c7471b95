//! A whole recording, or some rows of it: cut into pixels, solved side by side, put together.

use crate::co_located::{CoLocated, CoLocatedEvents, values_of};
use crate::elsewhere::rows_elsewhere;
use crate::host::Host;
use crate::model::{Model, late_description};
use crate::options::{PaperOptions, SolveOptions};
use crate::row::Recorded;
use crate::settings::{BLOCK_ROWS, COMPANY_ROWS, HALO_ROWS, Settings};
use crate::shares::Colours;
use crate::status::{Report, map_meta, of_pixels};
use crate::{neighbours, paper, row_solver};
use photocurrent_core::handle::Band;
use photocurrent_core::{
    Colour, EventStream, EventsMeta, Exposure, FrameBlock, FrameSequence, FramesMeta, MapBand, MapSet,
    NodeError, Rows, Sensor, TrackBand, TrackSet, TracksMeta,
};
use rayon::prelude::*;
use std::sync::Arc;

/// What a sensor recorded, with its description.
#[derive(Clone, Copy)]
pub struct Recording<'a> {
    /// Events.
    pub events: &'a EventStream,
    /// Captured frames of the same pixels, or of a whole number of pixels along the side of each event pixel;
    /// at least one.
    pub frames: &'a FrameSequence,
    /// Thresholds, gain, and what the chosen models need.
    pub sensor: &'a Sensor,
}

/// The light of some rows, and how its solution went.
pub struct Solution {
    /// Photocurrent of every value of the frames over time.
    pub tracks: TrackSet,
    /// Planes [`crate::PLANES`], a value a pixel.
    pub map: MapSet,
    /// Pixels that did not come out as they should.
    pub report: Report,
    /// What the description states and the solution does not use, as a sentence.
    pub not_modelled: Option<String>,
}

/// The MAP estimate of a whole recording.
///
/// # Errors
/// When the description lacks what is needed ([`Model::of_map`]), the streams do not lie on each other, or
/// one cannot be read.
pub fn solve(recording: &Recording<'_>, options: &SolveOptions) -> Result<Solution, NodeError> {
    options.check()?;
    solve_rows(recording, options, recording.frames.meta.extent.rows(), &())
}

/// Rows of a recording, as they are read.
pub(crate) struct Part {
    /// Rows whose events are at hand.
    rows: Rows,
    events: CoLocatedEvents,
    frames: FrameBlock,
}

/// Reads rows.
pub(crate) struct Reader<'a> {
    recording: &'a Recording<'a>,
    pub(crate) colours: Colours,
    pub(crate) all: Rows,
    /// To the solvers, every value of a row is a pixel.
    pub(crate) wide: TracksMeta,
}

impl Reader<'_> {
    pub(crate) fn new<'a>(recording: &'a Recording<'a>, meta: &TracksMeta) -> Result<Reader<'a>, NodeError> {
        let colours =
            Colours::new(CoLocated::new(&recording.events.meta, &recording.frames.meta)?, recording.sensor)?;
        let wide =
            TracksMeta { extent: values_of(meta.extent, meta.colour), colour: Colour::Mono, ..meta.clone() };
        Ok(Reader { recording, colours, all: meta.extent.rows(), wide })
    }

    pub(crate) fn read(&self, rows: Rows) -> Result<Part, NodeError> {
        let events = self.colours.lie.read(self.recording.events, rows)?;
        Ok(Part {
            rows,
            events,
            frames: self.recording.frames.read_rows(rows.with_halo(self.colours.halo(), self.all))?,
        })
    }

    pub(crate) fn recorded<'b>(&'b self, part: &'b Part) -> Recorded<'b> {
        let times = &self.recording.frames.meta.times;
        Recorded {
            meta: &self.wide,
            times,
            colours: &self.colours,
            rows: part.rows,
            events: &part.events,
            frames: &part.frames,
        }
    }
}

/// Pixels that are solved elsewhere at once, in whole rows: enough for a card, and every thread holds as many
/// laid out, some 100 MB where they have 200 knots.
const BATCH_PIXELS: usize = 8_192;

/// Rows in memory at a time where a block is read in parts.
const HELD_ROWS: u32 = 4;

/// Rows of frames above and below those of the result that the MAP estimate reads: those of a block share
/// their settings. `None` where all rows must be solved together, since effects couple all pixels.
///
/// # Errors
/// As [`Model::of_map`].
pub fn halo(
    options: &SolveOptions,
    sensor: &Sensor,
    events: &EventsMeta,
    frames: &FramesMeta,
) -> Result<Option<u32>, NodeError> {
    let (lie, model) = (CoLocated::new(events, frames)?, Model::of_map(options, sensor, events)?);
    if model.couples() {
        return Ok(None);
    }
    Ok(Some(neighbours::halo(&model, lie).unwrap_or(HALO_ROWS).saturating_add(lie.ratio - 1)))
}

/// The MAP estimate of some rows of a recording: the same bits for any division into rows.
///
/// # Errors
/// As [`solve`]; when `host` gives up; when what reaches over rows is not at hand.
pub fn solve_rows(
    recording: &Recording<'_>,
    options: &SolveOptions,
    rows: Rows,
    host: &dyn Host,
) -> Result<Solution, NodeError> {
    let meta = options.tracks_meta(&recording.events.meta, &recording.frames.meta)?;
    let mut model = Model::of_map(options, recording.sensor, &recording.events.meta)?;
    model.inform(recording.events)?;
    let reader = Reader::new(recording, &meta)?;
    let coupled = neighbours::halo(&model, reader.colours.lie);
    let is_low = rows.len() < BLOCK_ROWS as usize;
    if coupled.is_none() && is_low && Settings::chosen(rows, host).is_none() {
        // Bands are this low where memory is short, so not even the rows of a block are held at once.
        let mut held: Option<Part> = None;
        Settings::choose_row_by_row(options, &model, &reader.wide, rows, host, |data, row| {
            let company = Rows { start: row, end: row + 1 }.with_halo(COMPANY_ROWS, reader.all);
            let part =
                match &mut held {
                    Some(held) if held.rows.contains(company) => held,
                    held => held.insert(reader.read(
                        Rows { start: row, end: row + HELD_ROWS }.with_halo(COMPANY_ROWS, reader.all),
                    )?),
                };
            data.take(&model, &reader.recorded(part), row, 0.0)
        })?;
    }
    // Once settings are chosen, only the neighbours of events are around.
    let around = if Settings::chosen(rows, host).is_some() { COMPANY_ROWS } else { HALO_ROWS };
    let at_hand = rows.with_halo(coupled.unwrap_or(around), reader.all);
    if !recording.events.rows().contains(reader.colours.lie.event_rows(at_hand)) {
        return Err(late_description("the description mixes the light of neighbouring pixels"));
    }
    let part = reader.read(at_hand)?;
    let recorded = reader.recorded(&part);
    let known = neighbours::known(options, &model, &recorded, rows, host)?;
    let settings = Settings::choose_once(options, &model, &recorded, rows, known.as_ref(), host)?;
    let solve_row = |solver: &mut row_solver::RowSolver,
                     row: u32|
     -> Result<(TrackBand, MapBand), NodeError> {
        let (tracks, map) = solver.row(&model, settings.of(row), &recorded, row, known.as_ref(), is_low)?;
        host.advance(1)?;
        Ok((tracks, of_pixels(map, &meta)))
    };
    if let Some(elsewhere) = host.elsewhere() {
        let all: Vec<u32> = rows.iter().collect();
        let at_once = (BATCH_PIXELS / reader.wide.extent.width.max(1) as usize).max(1);
        let solve = |rows: &[u32]| {
            let known = known.as_ref();
            let (solved, left) = rows_elsewhere(elsewhere, &model, &settings, &recorded, rows, known)?;
            host.left_here(left as u64);
            host.advance(rows.len() as u64)?;
            Ok(solved.into_iter().map(|(tracks, map)| (tracks, of_pixels(map, &meta))).collect())
        };
        let solved: Result<Vec<Vec<_>>, NodeError> = all.par_chunks(at_once).map(solve).collect();
        return Ok(together(
            meta.clone(),
            solved?.into_iter().flatten().collect(),
            model.not_modelled(recording.sensor),
        ));
    }
    // Of a low band, the pixels of each row are shared out over the threads, one row after the other.
    let solved: Result<Vec<_>, NodeError> = if is_low {
        let mut memory = Default::default();
        rows.iter().map(|row| solve_row(&mut memory, row)).collect()
    } else {
        rows.iter().into_par_iter().map_init(Default::default, solve_row).collect()
    };
    Ok(together(meta, solved?, model.not_modelled(recording.sensor)))
}

/// The solution of Eq. (13) for some rows of a recording.
///
/// # Errors
/// As [`solve`], with [`Model::of_paper`].
pub fn solve_paper_rows(
    recording: &Recording<'_>,
    options: &PaperOptions,
    rows: Rows,
    host: &dyn Host,
) -> Result<Solution, NodeError> {
    let meta = options.tracks_meta(&recording.events.meta, &recording.frames.meta)?;
    let model = Model::of_paper(options, recording.sensor, &recording.events.meta)?;
    let reader = Reader::new(recording, &meta)?;
    let part = reader.read(rows)?;
    let times = &recording.frames.meta.times;
    let solve_row = |solver: &mut paper::RowSolver, row: u32| -> Result<(TrackBand, MapBand), NodeError> {
        let exposures: Vec<Exposure> = (0..times.len()).map(|l| times.exposure(l, row)).collect();
        let shares = reader.colours.row(&model, &part.frames, row);
        let solved = part.events.with_row(row, |events| {
            solver.row(options, &model, &reader.wide, row, events, &part.frames, &exposures, &shares)
        })?;
        let (tracks, map) = solved?;
        host.advance(1)?;
        Ok((tracks, of_pixels(map, &meta)))
    };
    let solved: Result<Vec<_>, NodeError> =
        rows.iter().into_par_iter().map_init(Default::default, solve_row).collect();
    Ok(together(meta, solved?, crate::pixel_events::left_out(recording.sensor)))
}

fn together(meta: TracksMeta, solved: Vec<(TrackBand, MapBand)>, not_modelled: Option<String>) -> Solution {
    let (tracks, maps): (Vec<TrackBand>, Vec<MapBand>) = solved.into_iter().unzip();
    let map = MapBand::concat(maps);
    let (report, map_meta) = (Report::of(&map), Arc::new(map_meta(meta.extent)));
    Solution {
        tracks: TrackSet::in_memory(Arc::new(meta), TrackBand::concat(tracks)),
        map: MapSet::in_memory(map_meta, map),
        report,
        not_modelled,
    }
}
