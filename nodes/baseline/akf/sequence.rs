//! When the filter does what to all pixels at once: takes a new pair of frames, resets its reference, writes
//! a picture.
//!
//! The authors' program takes one event after the other, and its clock is the events': a frame is changed, a
//! reference reset, a picture written at the first event past an instant. So this is worked out first, from
//! the order of all events; afterwards every pixel runs by itself.

use super::events::Key;
use super::settings::{Sequence, Variant};
use photocurrent_core::Exposure;

/// Where in one event's turn something happens.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Phase {
    /// Before the event counts.
    Before,
    /// After the reference moved, before the state is updated.
    FrameTime,
    /// After all of the event.
    After,
}

/// What happens to all pixels.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum What {
    /// Window number so much begins.
    Window(usize),
    /// The reference becomes the latent picture at the exposure's start.
    Reset,
    /// The authors write a picture at a frame's time, which clips the reference: `frame`, and the
    /// interpolation weight then.
    FramePicture(usize, f64),
    /// Picture number so much of those asked for, and the interpolation weight then.
    Picture(usize, f64),
    /// State and covariance of every pixel are brought up to date, with the interpolation weight then; a
    /// picture does the same.
    Update(f64),
}

/// Something that happens to all pixels, and when.
pub type Control = (Key, Phase, What);

/// One exposure to deblur: its times, and the events that the authors' program meets first at or after them.
#[derive(Clone, Copy, Debug)]
pub struct Span {
    /// Start, middle, end in ns.
    pub t: [i64; 3],
    /// First event at or after each.
    pub key: [Key; 3],
}

/// The pair of frames between which the reference is interpolated.
#[derive(Clone, Debug)]
pub struct Window {
    /// The earlier frame.
    pub frame: usize,
    /// Its exposure.
    pub first: Span,
    /// The next frame's exposure; none after the last frame.
    pub second: Option<Span>,
}

impl Window {
    /// Where between the two exposures an instant lies, 0 to 1; none when it is not between them.
    pub fn weight(&self, t: i64) -> Option<f64> {
        let from = self.first.t[2];
        let to = self.second.as_ref()?.t[0];
        (from..=to).contains(&t).then(|| if to > from { (t - from) as f64 / (to - from) as f64 } else { 0.0 })
    }
}

/// The whole course.
#[derive(Debug)]
pub struct Course {
    /// First event that counts.
    pub start: Key,
    /// The pairs of frames; the first is the one to start with.
    pub windows: Vec<Window>,
    /// In order.
    pub controls: Vec<Control>,
    /// Nothing counts from here on.
    pub stop: Key,
}

/// Later than everything.
const NEVER: Key = (i64::MAX, u32::MAX);

struct Builder<'a> {
    exposures: &'a [Exposure],
    order: &'a [Key],
    variant: Variant,
}

impl Builder<'_> {
    fn first_from(&self, t: i64) -> usize {
        self.order.partition_point(|key| key.0 < t)
    }

    /// The exposure of a frame; the authors take the length of the window's first frame for both.
    fn span(&self, frame: usize, window: usize) -> Span {
        let length = match self.variant {
            Variant::AsReleased => self.exposures[window].length_ns(),
            Variant::Corrected => self.exposures[frame].length_ns(),
        };
        let mid = self.exposures[frame].mid().0;
        let start = mid - length.div_euclid(2);
        let t = [start, mid, start + length];
        Span { t, key: t.map(|t| self.order.get(self.first_from(t)).copied().unwrap_or(NEVER)) }
    }

    fn window(&self, frame: usize) -> Window {
        let second = (frame + 1 < self.exposures.len()).then(|| self.span(frame + 1, frame));
        Window { frame, first: self.span(frame, frame), second }
    }

    /// Event by event, as the authors' program.
    fn as_released(&self, instants: &[i64]) -> Course {
        let count = self.exposures.len();
        let from = self.first_from(self.exposures[1].mid().0);
        let mut windows = vec![self.window(1)];
        let mut controls = Vec::new();
        // High-rate pictures begin with the end of the second frame's exposure.
        let mut picture = instants.partition_point(|t| *t < windows[0].first.t[2]);
        let (mut entering, mut due, mut weight, mut stop) = (true, false, 0.0, NEVER);
        for &key in &self.order[from..] {
            let t = key.0;
            let mut now = windows.last().expect("there is a first window");
            if now.second.as_ref().is_some_and(|second| t > second.t[0]) {
                let frame = now.frame + 1;
                if frame + 1 >= count - 2 {
                    stop = key;
                    break;
                }
                windows.push(self.window(frame));
                controls.push((key, Phase::Before, What::Window(windows.len() - 1)));
                (entering, due) = (true, true);
                now = windows.last().expect("one was pushed");
            } else if entering && (now.first.t[0]..=now.first.t[2]).contains(&t) {
                entering = false;
                controls.push((key, Phase::Before, What::Reset));
            }
            if due && t > now.first.t[1] {
                due = false;
                controls.push((key, Phase::FrameTime, What::FramePicture(now.frame, weight)));
            }
            if let Some(between) = now.weight(t) {
                weight = between;
            } else if (now.first.t[0]..now.first.t[2]).contains(&t) {
                weight = 0.0;
            }
            if instants.get(picture).is_some_and(|instant| t > *instant) {
                controls.push((key, Phase::After, What::Picture(picture, weight)));
                picture += 1;
            }
        }
        Course { start: self.order.get(from).copied().unwrap_or(NEVER), windows, controls, stop }
    }

    /// At the instants themselves, from the first frame or event to the last.
    fn whole(&self, instants: &[i64], update_ns: f64) -> Course {
        let windows: Vec<Window> = (0..self.exposures.len()).map(|frame| self.window(frame)).collect();
        let at = |t: i64| windows.partition_point(|window| window.first.t[0] <= t).saturating_sub(1);
        let begins = |w: usize| {
            let key = (windows[w].first.t[0], 0);
            [(key, Phase::Before, What::Window(w)), (key, Phase::Before, What::Reset)]
        };
        let mut controls: Vec<Control> = (0..windows.len()).flat_map(begins).collect();
        let weight = |t: i64| windows[at(t)].weight(t).unwrap_or(0.0);
        controls.extend(
            instants
                .iter()
                .enumerate()
                .map(|(picture, &t)| ((t, u32::MAX), Phase::After, What::Picture(picture, weight(t)))),
        );
        if let Some(&last) = instants.last() {
            let updates = (1..)
                .map(|k| windows[0].first.t[0] + (f64::from(k) * update_ns).round() as i64)
                .take_while(|t| *t < last);
            controls.extend(updates.map(|t| ((t, u32::MAX), Phase::After, What::Update(weight(t)))));
        }
        // Stable: a window begins before its reset.
        controls.sort_by_key(|(key, phase, _)| (*key, *phase));
        let first =
            [self.order.first().map(|key| key.0), instants.first().copied(), Some(windows[0].first.t[0])];
        let start = first.into_iter().flatten().min().unwrap_or(0);
        Course { start: (start, 0), windows, controls, stop: NEVER }
    }
}

/// The course over frames with these exposures, events in this order, and pictures at these instants
/// (ascending). The authors' sequence needs four frames at least; ours one. Between pictures, ours brings
/// every pixel up to date each `update_ns`; the authors' does so at pictures alone.
pub fn course(
    exposures: &[Exposure],
    order: &[Key],
    instants: &[i64],
    variant: Variant,
    sequence: Sequence,
    update_ns: f64,
) -> Course {
    let builder = Builder { exposures, order, variant };
    match sequence {
        Sequence::AsReleased => builder.as_released(instants),
        Sequence::Whole => builder.whole(instants, update_ns),
    }
}
