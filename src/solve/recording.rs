//! A whole recording, or some rows of it: cut into pixels, solved side by side, put together.

use crate::co_located::{CoLocated, CoLocatedEvents, values_of};
use crate::elsewhere::{ElsewhereRows, RowPicture};
use crate::host::Host;
use crate::model::{Model, late_description};
use crate::options::{PaperOptions, SolveOptions};
use crate::row::{KnownOfRows, Recorded};
use crate::settings::{BLOCK_ROWS, COMPANY_ROWS, HALO_ROWS, Settings};
use crate::shares::Colours;
use crate::status::{Report, map_meta, of_pixels};
use crate::{neighbours, paper, row_solver};
use photocurrent_core::handle::Band;
use photocurrent_core::{
    Colour, EventStream, EventsMeta, Exposure, FrameBlock, FrameSequence, FramesMeta, MapBand, MapSet,
    NodeError, Rows, Sensor, TrackBand, TrackSet, TracksMeta,
};
use photocurrent_sensor::map::Elsewhere;
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

/// Steps of a pixel's chain a second where much moves, and bytes of one laid out: as it is laid, and in
/// columns.
const STEPS_PER_S: f64 = 2_240.0;
const STEP_BYTES: f64 = 64.0;

/// About how many bytes pixels take that a thread lays out for another processor.
pub fn elsewhere_bytes(meta: &TracksMeta) -> u64 {
    let pixels = values_of(meta.extent, meta.colour).pixels().min(BATCH_PIXELS);
    (pixels as f64 * STEPS_PER_S * f64::max(meta.span.length_ns() as f64 * 1e-9, 0.1) * STEP_BYTES) as u64
}

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

/// Pictures of some rows in place of their light, and how their solution went.
pub struct Pictures {
    /// Rows in order.
    pub rows: Vec<RowPicture>,
    /// Planes [`crate::PLANES`], a value a pixel.
    pub map: MapSet,
    /// Pixels that did not come out as they should.
    pub report: Report,
    /// What the description states and the solution does not use, as a sentence.
    pub not_modelled: Option<String>,
}

/// What rows are solved with, once noise and prior are chosen.
struct Prepared<'a> {
    meta: &'a TracksMeta,
    model: &'a Model,
    recorded: &'a Recorded<'a>,
    known: Option<&'a KnownOfRows>,
    settings: &'a Settings,
}

/// What `work` makes of rows that are prepared.
fn prepared<T>(
    recording: &Recording<'_>,
    options: &SolveOptions,
    rows: Rows,
    host: &dyn Host,
    work: impl FnOnce(&Prepared<'_>) -> Result<T, NodeError>,
) -> Result<T, NodeError> {
    let meta = options.tracks_meta(&recording.events.meta, &recording.frames.meta)?;
    let mut model = Model::of_map(options, recording.sensor, &recording.events.meta)?;
    model.inform(recording.events)?;
    let reader = Reader::new(recording, &meta)?;
    let coupled = neighbours::halo(&model, reader.colours.lie);
    if coupled.is_none() && is_low(rows) && Settings::chosen(rows, host).is_none() {
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
    work(&Prepared {
        meta: &meta,
        model: &model,
        recorded: &recorded,
        known: known.as_ref(),
        settings: &settings,
    })
}

/// Are rows so few that they are solved one after the other?
fn is_low(rows: Rows) -> bool {
    rows.len() < BLOCK_ROWS as usize
}

impl Prepared<'_> {
    fn elsewhere<'a>(&'a self, elsewhere: &'a dyn Elsewhere) -> ElsewhereRows<'a> {
        let Prepared { model, recorded, known, settings, .. } = *self;
        ElsewhereRows { elsewhere, model, settings, recorded, given: known }
    }

    /// Gives rows to `solve`, as many as are solved elsewhere at once, and joins what it makes of them.
    fn batches<T: Send>(
        &self,
        rows: Rows,
        host: &dyn Host,
        solve: impl Fn(&[u32]) -> Result<(Vec<(T, MapBand)>, usize), NodeError> + Sync,
    ) -> Result<Vec<(T, MapBand)>, NodeError> {
        let all: Vec<u32> = rows.iter().collect();
        let at_once = (BATCH_PIXELS / self.recorded.meta.extent.width.max(1) as usize).max(1);
        let solve = |rows: &[u32]| {
            let (solved, left) = solve(rows)?;
            host.left_here(left as u64);
            host.advance(rows.len() as u64)?;
            Ok(solved.into_iter().map(|(light, map)| (light, of_pixels(map, self.meta))).collect())
        };
        let solved: Result<Vec<Vec<_>>, NodeError> = all.par_chunks(at_once).map(solve).collect();
        Ok(solved?.into_iter().flatten().collect())
    }
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
    prepared(recording, options, rows, host, |prepared| {
        let Prepared { meta, model, recorded, known, settings } = *prepared;
        let not_modelled = model.not_modelled(recording.sensor);
        if let Some(elsewhere) = host.elsewhere() {
            let solved = prepared.batches(rows, host, |rows| prepared.elsewhere(elsewhere).tracks(rows))?;
            return Ok(together(meta.clone(), solved, not_modelled));
        }
        let solve_row = |solver: &mut row_solver::RowSolver,
                         row: u32|
         -> Result<(TrackBand, MapBand), NodeError> {
            let (tracks, map) = solver.row(model, settings.of(row), recorded, row, known, is_low(rows))?;
            host.advance(1)?;
            Ok((tracks, of_pixels(map, meta)))
        };
        // Of a low band, the pixels of each row are shared out over the threads, one row after the other.
        let solved: Result<Vec<_>, NodeError> = if is_low(rows) {
            let mut memory = Default::default();
            rows.iter().map(|row| solve_row(&mut memory, row)).collect()
        } else {
            rows.iter().into_par_iter().map_init(Default::default, solve_row).collect()
        };
        Ok(together(meta.clone(), solved?, not_modelled))
    })
}

/// Means of the light of [`solve_rows`] over `exposures` of each row, as many for every row, where pixels are
/// solved elsewhere: no track comes back. None where they are solved here, or effects add to the light.
///
/// # Errors
/// As [`solve_rows`].
pub fn picture_rows(
    recording: &Recording<'_>,
    options: &SolveOptions,
    rows: Rows,
    exposures: &(dyn Fn(u32) -> Vec<Exposure> + Sync),
    host: &dyn Host,
) -> Result<Option<Pictures>, NodeError> {
    let Some(elsewhere) = host.elsewhere() else { return Ok(None) };
    if Model::of_map(options, recording.sensor, &recording.events.meta)?.undo.added() != 0.0 {
        return Ok(None);
    }
    prepared(recording, options, rows, host, |prepared| {
        let solved = prepared.batches(rows, host, |rows| {
            let exposures: Vec<Vec<Exposure>> = rows.iter().map(|&row| exposures(row)).collect();
            prepared.elsewhere(elsewhere).pictures(rows, &exposures)
        })?;
        let (rows, maps): (Vec<RowPicture>, Vec<MapBand>) = solved.into_iter().unzip();
        let map = MapBand::concat(maps);
        let (report, map_meta) = (Report::of(&map), Arc::new(map_meta(prepared.meta.extent)));
        let map = MapSet::in_memory(map_meta, map);
        let not_modelled = prepared.model.not_modelled(recording.sensor);
        Ok(Some(Pictures { rows, map, report, not_modelled }))
    })
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
