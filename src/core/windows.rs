//! Values in time: a window cut out of a recording, and parts that follow each other joined.
//!
//! Both are views. A window of events or frames reads what is stamped, or wholly exposed, within it; joined
//! parts read each instant from one part only, that whose share of time it lies in. So a recording can be
//! worked on in blocks that overlap, and what they give is one value again.

use crate::error::DataError;
use crate::events::EventsMeta;
use crate::extent::Rows;
use crate::frames::{FrameBlock, FrameSequence, FrameSource, FrameTimes, FramesMeta};
use crate::handle::{BandMeta, BandSource, Handle, InTime};
use crate::time::{Exposure, TimeSpan};
use crate::tracks::TracksMeta;
use crate::value::{Meta, Value};
use std::ops::Range;
use std::sync::Arc;

struct Within<M: BandMeta> {
    of: Handle<M>,
    window: TimeSpan,
}

impl<M: BandMeta> BandSource<M::Band> for Within<M>
where
    M::Band: InTime,
{
    fn read(&self, rows: Rows) -> Result<M::Band, DataError> {
        self.of.read_within(rows, self.window)
    }
}

struct Joined<M: BandMeta>(Vec<(Handle<M>, TimeSpan)>);

impl<M: BandMeta> BandSource<M::Band> for Joined<M>
where
    M::Band: InTime,
{
    fn read(&self, rows: Rows) -> Result<M::Band, DataError> {
        let parts: Result<Vec<M::Band>, DataError> =
            self.0.iter().map(|(part, share)| part.read_within(rows, *share)).collect();
        Ok(M::Band::follow(parts?))
    }

    fn bytes(&self, rows: Rows) -> Option<u64> {
        // What lies outside of the shares is counted as well: they overlap by little.
        self.0.iter().map(|(part, _)| part.bytes(rows)).sum()
    }
}

impl<M: BandMeta> Handle<M>
where
    M::Band: InTime,
{
    /// What of the data is stamped within the window; `meta` states what is known of it.
    #[must_use]
    pub fn within(&self, meta: Arc<M>, window: TimeSpan) -> Self {
        Handle::new(meta, self.rows(), Arc::new(Within { of: self.clone(), window }))
    }

    fn joined(meta: Arc<M>, parts: Vec<(Self, TimeSpan)>) -> Self {
        let rows = parts
            .iter()
            .map(|(part, _)| part.rows())
            .reduce(|all, rows| all.intersect(rows))
            .unwrap_or(Rows { start: 0, end: 0 });
        Handle::new(meta, rows, Arc::new(Joined(parts)))
    }
}

struct Following {
    row_values: usize,
    parts: Vec<FrameSequence>,
}

impl FrameSource for Following {
    fn read(&self, frames: Range<usize>, rows: Rows) -> Result<FrameBlock, DataError> {
        let mut dn = Vec::with_capacity(frames.len() * rows.len() * self.row_values);
        let mut first = 0;
        for part in &self.parts {
            let (from, to) = (frames.start.max(first), frames.end.min(first + part.len()));
            if from < to {
                dn.extend(part.read(from - first..to - first, rows)?.dn);
            }
            first += part.len();
        }
        Ok(FrameBlock { frames, rows, row_values: self.row_values, dn })
    }
}

/// Frames of the first part, then those of the next, without copying; `meta` states what is known of all.
fn follow(meta: Arc<FramesMeta>, parts: Vec<FrameSequence>) -> FrameSequence {
    let rows = parts.iter().map(FrameSequence::rows).reduce(|all, rows| all.intersect(rows));
    let rows = rows.unwrap_or(Rows { start: 0, end: 0 });
    FrameSequence::new(meta.clone(), rows, Arc::new(Following { row_values: meta.row_values(), parts }))
}

impl EventsMeta {
    /// What is known of the events within a window: their number is taken for proportional to time.
    #[must_use]
    pub fn within(&self, window: TimeSpan) -> EventsMeta {
        let Some(span) = self.span else { return self.clone() };
        let (start, end) = (span.start.max(window.start), span.end.min(window.end));
        let share = (end.0 - start.0).max(0) as f64 / (span.end.0 - span.start.0).max(1) as f64;
        let count_hint = self.count_hint.map(|count| (count as f64 * share).ceil() as u64);
        EventsMeta { span: Some(TimeSpan::new(start.0.min(end.0), end.0)), count_hint, ..self.clone() }
    }
}

impl FrameTimes {
    /// The frames that are exposed wholly within the window, with every row of a sensor of `height` rows.
    pub fn within(&self, window: TimeSpan, height: u32) -> Vec<usize> {
        let last = height.saturating_sub(1);
        let inside = |l: &usize| {
            let (first, last) = (self.exposure(*l, 0), self.exposure(*l, last));
            first.start.min(last.start) >= window.start && first.end.max(last.end) <= window.end
        };
        (0..self.len()).filter(inside).collect()
    }

    /// The frames whose first row is exposed around an instant of this share of time: shares that follow each
    /// other have each frame once.
    fn in_share(&self, share: TimeSpan) -> Vec<usize> {
        (0..self.len()).filter(|l| (share.start..share.end).contains(&self.exposures[*l].mid())).collect()
    }
}

impl FramesMeta {
    /// What is known of the frames that are exposed wholly within the window.
    #[must_use]
    pub fn within(&self, window: TimeSpan) -> FramesMeta {
        FramesMeta {
            times: self.times.select(&self.times.within(window, self.extent.height)),
            ..self.clone()
        }
    }
}

impl Meta {
    /// The time that the value covers, where it has one and windows leave a part of it.
    pub fn span_to_cut(&self) -> Option<TimeSpan> {
        match self {
            Meta::Events(meta) => meta.span,
            Meta::Frames(meta) => meta.times.span(meta.extent.height),
            _ => None,
        }
    }

    /// The longest exposure of frames, and how long after the first row the last one follows, ns.
    pub fn longest_frame_ns(&self) -> Option<(i64, i64)> {
        let Meta::Frames(meta) = self else { return None };
        let exposure_ns = meta.times.exposures.iter().map(Exposure::length_ns).max()?;
        Some((
            exposure_ns,
            meta.times.row_time_ns.saturating_mul(i64::from(meta.extent.height.saturating_sub(1))).abs(),
        ))
    }

    /// What is known of the value within a window of time; what is no recording stays whole.
    #[must_use]
    pub fn within(&self, window: TimeSpan) -> Meta {
        match self {
            Meta::Events(meta) => Meta::Events(Arc::new(meta.within(window))),
            Meta::Frames(meta) => Meta::Frames(Arc::new(meta.within(window))),
            other => other.clone(),
        }
    }

    /// What is known of parts that follow each other in time, each with its share of it, as one value.
    ///
    /// # Errors
    /// When the parts are of a type that cannot be joined, or do not belong together; with the reason.
    pub fn joined_in_time(parts: &[(Meta, TimeSpan)]) -> Result<Meta, DataError> {
        macro_rules! metas {
            ($variant:ident) => {
                parts
                    .iter()
                    .filter_map(
                        |(part, share)| {
                            if let Meta::$variant(part) = part { Some((&**part, *share)) } else { None }
                        },
                    )
                    .collect::<Vec<_>>()
            };
        }
        let first = parts.first().ok_or_else(|| DataError::new("there is no part to join"))?;
        let joined = match &first.0 {
            Meta::Events(_) => Meta::Events(Arc::new(join_events(&metas!(Events))?)),
            Meta::Frames(_) => Meta::Frames(Arc::new(join_frames(&metas!(Frames))?)),
            Meta::Tracks(_) => Meta::Tracks(Arc::new(join_tracks(&metas!(Tracks))?)),
            other => {
                return Err(DataError::new(format!(
                    "each block of time has {} of its own, and nothing says what they are together",
                    other.data_type()
                )));
            }
        };
        Ok(joined)
    }
}

impl Value {
    /// What of the value lies within a window of time, without copying: events that are stamped in it, frames
    /// that are exposed wholly in it; all else stays whole.
    #[must_use]
    pub fn within(&self, window: TimeSpan) -> Value {
        match self {
            Value::Events(value) => Value::Events(value.within(Arc::new(value.meta.within(window)), window)),
            Value::Frames(value) => {
                Value::Frames(value.select(value.meta.times.within(window, value.meta.extent.height)))
            }
            other => other.clone(),
        }
    }

    /// Parts that follow each other in time as one value, each instant from the part whose share of time it
    /// lies in, without copying.
    ///
    /// # Errors
    /// As [`Meta::joined_in_time`].
    pub fn joined_in_time(parts: Vec<(Value, TimeSpan)>) -> Result<Value, DataError> {
        let metas: Vec<(Meta, TimeSpan)> = parts.iter().map(|(part, share)| (part.meta(), *share)).collect();
        macro_rules! of {
            ($variant:ident) => {
                parts
                    .into_iter()
                    .filter_map(
                        |(part, share)| {
                            if let Value::$variant(part) = part { Some((part, share)) } else { None }
                        },
                    )
                    .collect::<Vec<_>>()
            };
        }
        Ok(match Meta::joined_in_time(&metas)? {
            Meta::Events(meta) => Value::Events(Handle::joined(meta, of!(Events))),
            Meta::Tracks(meta) => Value::Tracks(Handle::joined(meta, of!(Tracks))),
            Meta::Frames(meta) => Value::Frames(follow(
                meta,
                of!(Frames)
                    .into_iter()
                    .map(|(part, share)| part.select(part.meta.times.in_share(share)))
                    .collect(),
            )),
            _ => return Err(DataError::new("only events, frames and tracks are joined")),
        })
    }
}

/// The first part, and whether every other one is as it, some fields left out by `bare`.
fn alike<'a, M: PartialEq>(
    parts: &[(&'a M, TimeSpan)],
    bare: impl Fn(&M) -> M,
    what: &str,
) -> Result<&'a M, DataError> {
    let first =
        parts.first().map(|(part, _)| *part).ok_or_else(|| DataError::new("there is no part to join"))?;
    match parts.iter().position(|(part, _)| bare(part) != bare(first)) {
        Some(other) => Err(DataError::new(format!(
            "{what} of block {} of time are not like those of the first",
            other + 1
        ))),
        None => Ok(first),
    }
}

fn join_events(parts: &[(&EventsMeta, TimeSpan)]) -> Result<EventsMeta, DataError> {
    let first = alike(parts, |meta| EventsMeta { span: None, count_hint: None, ..meta.clone() }, "events")?;
    let span = parts.iter().filter_map(|(part, _)| part.span).reduce(TimeSpan::union);
    let count_hint = parts.iter().map(|(part, _)| part.count_hint).sum();
    Ok(EventsMeta { span, count_hint, ..first.clone() })
}

fn join_tracks(parts: &[(&TracksMeta, TimeSpan)]) -> Result<TracksMeta, DataError> {
    let (first, end) = (parts.first().map(|(part, _)| part.span), parts.last().map(|(part, _)| part.span));
    let span = first.zip(end).map_or(TimeSpan::new(0, 0), |(first, end)| first.union(end));
    let first = alike(
        parts,
        |meta| TracksMeta { span, count_hint: None, nominal_exposure_ns: 0, ..meta.clone() },
        "tracks",
    )?;
    same_scale(parts.iter().map(|(part, _)| part.nominal_exposure_ns))?;
    let count_hint = parts.iter().map(|(part, _)| part.count_hint).sum();
    Ok(TracksMeta { span, count_hint, ..first.clone() })
}

fn join_frames(parts: &[(&FramesMeta, TimeSpan)]) -> Result<FramesMeta, DataError> {
    use crate::frames::FrameScale::{Captured, Nominal};
    let scale_of = |meta: &FramesMeta| match meta.scale {
        Captured => -1,
        Nominal { exposure_ns } => exposure_ns,
    };
    same_scale(parts.iter().map(|(part, _)| scale_of(part)))?;
    let bare = |meta: &FramesMeta| FramesMeta {
        times: FrameTimes { exposures: Arc::default(), row_time_ns: meta.times.row_time_ns },
        ..meta.clone()
    };
    let first = alike(parts, bare, "frames")?;
    let kept = |(part, share): &(&FramesMeta, TimeSpan)| {
        part.times.in_share(*share).into_iter().map(|l| part.times.exposures[l]).collect::<Vec<_>>()
    };
    let exposures = parts.iter().flat_map(kept).collect();
    Ok(FramesMeta { times: FrameTimes::new(exposures, first.times.row_time_ns)?, ..first.clone() })
}

/// Refuses parts whose DN stand for different exposures.
fn same_scale(mut exposures_ns: impl Iterator<Item = i64>) -> Result<(), DataError> {
    let first = exposures_ns.next();
    match exposures_ns.position(|other| Some(other) != first) {
        Some(other) => Err(DataError::new(format!(
            "frames of the recording are exposed differently in block {} of time than in the first, so that \
             DN of the two are not of one scale",
            other + 2
        ))),
        None => Ok(()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing;

    const MS: i64 = 1_000_000;

    /// Shares that follow each other, with windows that reach 5 ms further.
    fn blocks() -> [(TimeSpan, TimeSpan); 3] {
        let all = [(i64::MIN, 30 * MS), (30 * MS, 61 * MS), (61 * MS, i64::MAX)];
        all.map(|(start, end)| {
            (
                TimeSpan::new(start.saturating_sub(5 * MS), end.saturating_add(5 * MS)),
                TimeSpan::new(start, end),
            )
        })
    }

    #[test]
    fn a_recording_that_was_cut_and_joined_is_what_it_was() {
        for value in [
            Value::Events(testing::events(6, 9)),
            Value::Frames(testing::frames(6, 9, 10)),
            Value::Tracks(testing::tracks(6, 9)),
        ] {
            let parts: Vec<(Value, TimeSpan)> =
                blocks().map(|(window, share)| (value.within(window), share)).into();
            // Every block leaves something out, and has more than its share.
            if let Value::Events(all) = &value {
                let count = |part: &Value| {
                    if let Value::Events(part) = part { part.read(part.rows()).unwrap().len() } else { 0 }
                };
                let counts: Vec<usize> = parts.iter().map(|(part, _)| count(part)).collect();
                let whole = all.read(all.rows()).unwrap().len();
                assert!(
                    counts.iter().all(|count| *count < whole) && counts.iter().sum::<usize>() > whole,
                    "{counts:?} of {whole}"
                );
            }
            let joined = Value::joined_in_time(parts).unwrap();
            assert_eq!(joined.digest().unwrap(), value.digest().unwrap(), "{value:?}");
            let rows = Rows { start: 2, end: 7 };
            assert_eq!(joined.cut(rows).digest().unwrap(), value.cut(rows).digest().unwrap(), "{value:?}");
        }
    }

    #[test]
    fn what_is_known_of_parts_is_known_before_they_are_there() {
        for value in [Value::Events(testing::events(3, 4)), Value::Frames(testing::frames(3, 4, 9))] {
            let metas: Vec<(Meta, TimeSpan)> =
                blocks().map(|(window, share)| (value.meta().within(window), share)).into();
            let values: Vec<(Value, TimeSpan)> =
                blocks().map(|(window, share)| (value.within(window), share)).into();
            assert!(metas.iter().zip(&values).all(|((meta, _), (value, _))| *meta == value.meta()));
            assert_eq!(Meta::joined_in_time(&metas).unwrap(), Value::joined_in_time(values).unwrap().meta());
        }
    }

    #[test]
    fn frames_around_a_border_are_taken_once_wherever_they_are_read() {
        let film = testing::frames(4, 3, 10);
        let Value::Frames(joined) = Value::joined_in_time(
            blocks().map(|(window, share)| (Value::Frames(film.clone()).within(window), share)).into(),
        )
        .unwrap() else {
            panic!("frames stay frames")
        };
        for (from, to) in [(0, 10), (2, 4), (3, 3), (5, 9), (9, 10)] {
            assert_eq!(
                joined.read(from..to, film.rows()).unwrap(),
                film.read(from..to, film.rows()).unwrap()
            );
        }
        assert!(joined.read(3..11, film.rows()).is_err());
    }

    #[test]
    fn what_does_not_belong_together_is_not_joined() {
        let share = TimeSpan::new(0, 10);
        let frames = |exposure_ns: i64| {
            let frames = testing::frames(3, 4, 3);
            Meta::Frames(Arc::new(FramesMeta {
                scale: crate::FrameScale::Nominal { exposure_ns },
                ..(*frames.meta).clone()
            }))
        };
        let refused =
            |parts: [Meta; 2]| Meta::joined_in_time(&parts.map(|part| (part, share))).unwrap_err().message;
        assert!(refused([frames(5), frames(6)]).contains("exposed differently in block 2"));
        assert!(
            refused([
                Value::Frames(testing::frames(3, 4, 3)).meta(),
                Value::Frames(testing::frames(3, 5, 3)).meta()
            ])
            .contains("frames of block 2")
        );
        assert!(
            refused([
                Value::Tracks(testing::tracks(3, 4)).meta(),
                Value::Tracks(testing::tracks(4, 4)).meta()
            ])
            .contains("tracks of block 2")
        );
        let map = Meta::Map(Arc::new(crate::MapMeta {
            extent: crate::Extent { width: 3, height: 4 },
            planes: vec!["a".into()],
        }));
        assert!(refused([map.clone(), map]).contains("map of its own"));
    }

    #[test]
    fn samples_keep_their_pixels_and_standard_deviations() {
        let mut band = crate::TrackBand::begin(0, 2);
        for pixel in 0..4_i64 {
            band.push_with_sigma(
                (0..5).map(|k| (k * 10 + pixel, (100 * pixel + k) as f32, (100 * pixel + k) as f32 * 0.5)),
            );
        }
        let early = band.within(TimeSpan::new(0, 21));
        assert_eq!(
            (early.pixel(0, 0).t.len(), early.pixel(1, 0).t.len(), early.pixel(1, 1).photocurrent.to_vec()),
            (3, 2, vec![300.0, 301.0])
        );
        let late = band.within(TimeSpan::new(21, 1000));
        let joined = crate::TrackBand::follow(vec![early, late]);
        assert_eq!(joined, band);
    }
}
