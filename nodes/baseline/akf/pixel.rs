//! One pixel of the filter: state, covariance, reference; and the latent values at the edges of exposures.

use super::events::{Key, PixelList, PixelLists};
use super::sequence::{Control, Course, Phase, Span, What, Window};
use super::settings::{Sequence, Settings, Variant};

/// Everything that all pixels share.
pub struct Shared<'a> {
    /// Numbers.
    pub settings: &'a Settings,
    /// When what happens to all pixels.
    pub course: &'a Course,
    /// All events.
    pub events: &'a PixelLists,
    /// Size of the sensor.
    pub width: u32,
    /// Size of the sensor.
    pub height: u32,
}

/// Which picture a value is for.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Picture {
    /// One of those asked for.
    Asked(usize),
    /// The authors' picture at the time of a frame.
    Frame(usize),
}

struct State<'a> {
    shared: &'a Shared<'a>,
    list: PixelList<'a>,
    /// Intensity of each frame, 0 to 1.
    frames: &'a [f64],
    log: f64,
    covariance: f64,
    updated: i64,
    reference: f64,
    /// Inverse covariance of a frame's value.
    certainty: f64,
    window: usize,
    /// Log latent at the start of the window's exposure.
    left: f64,
    /// The two ends of the interpolation, moved by every event.
    ends: [f64; 2],
    /// What an event's step is multiplied with there.
    scale: f64,
    /// The frame whose value stands in the interpolated certainty.
    stale: usize,
    /// Event at which the window, and the reset, happened.
    changed_at: Option<Key>,
    reset_at: Option<Key>,
}

/// Runs one pixel through the course and gives the intensity of every picture, in order; pictures before the
/// start or after the stop are not given. `frames` are the pixel's intensities.
pub fn run(shared: &Shared, pixel: u32, frames: &[f64], mut give: impl FnMut(Picture, f64)) {
    let course = shared.course;
    let list = shared.events.pixel(pixel);
    let mut state = State::begin(shared, list, frames);
    let mut neighbours = Neighbours::new(
        shared,
        pixel,
        if shared.settings.sequence == Sequence::AsReleased { 0 } else { course.start.0 },
    );
    let mut controls = course.controls.iter();
    let mut next = controls.next();
    let mut until = |state: &mut State, limit: (Key, Phase)| {
        while let Some(control) = next.filter(|(key, phase, _)| (*key, *phase) < limit) {
            state.apply(control, &mut give);
            next = controls.next();
        }
    };
    for k in list.first_from(course.start)..list.first_from(course.stop) {
        let (key, step) = ((list.t[k], pixel), list.step[k]);
        until(&mut state, (key, Phase::FrameTime));
        state.enter(key, step);
        until(&mut state, (key, Phase::After));
        let noise = neighbours.noise(key);
        state.event(key.0, step, noise);
    }
    until(&mut state, (course.stop, Phase::Before));
}

impl<'a> State<'a> {
    fn begin(shared: &'a Shared<'a>, list: PixelList<'a>, frames: &'a [f64]) -> State<'a> {
        let settings = shared.settings;
        let mut state = State {
            shared,
            list,
            frames,
            log: 0.0,
            covariance: settings.covariance,
            updated: 0,
            reference: 0.0,
            certainty: 1.0,
            window: 0,
            left: 0.0,
            ends: [0.0; 2],
            scale: 1.0,
            stale: 0,
            changed_at: None,
            reset_at: None,
        };
        let window = &shared.course.windows[0];
        state.left = state.edges(window).0;
        let start = match settings.sequence {
            // The first pair of frames is taken as it is.
            Sequence::AsReleased => {
                let (from, to) = (
                    libm::log1p(frames[window.frame]),
                    frames.get(window.frame + 1).map_or(f64::NAN, |i| libm::log1p(*i)),
                );
                state.scale = state.scale_between(window, from, to);
                state.stale = window.frame + 1;
                from
            }
            // Back from the first exposure's start by what events say.
            Sequence::Whole => {
                state.updated = shared.course.start.0;
                state.left - list.sum(shared.course.start, (window.first.t[0] - 1, u32::MAX))
            }
        };
        (state.log, state.reference, state.ends) = (start, start, [start; 2]);
        state
    }

    fn window(&self) -> &'a Window {
        &self.shared.course.windows[self.window]
    }

    fn apply(&mut self, (key, _, what): &Control, give: &mut impl FnMut(Picture, f64)) {
        match *what {
            What::Window(w) => {
                self.window = w;
                self.changed_at = Some(*key);
                let window = self.window();
                let (left, right) = self.edges(window);
                self.left = left;
                (self.scale, self.ends) = match right {
                    Some(right) => {
                        let scale = self.scale_between(window, left, right);
                        (scale, [left, right - scale * self.net(window)])
                    }
                    None => (1.0, [left; 2]),
                };
                self.certainty = self.certainty_of(0.0, window.frame, window.frame);
            }
            What::Reset => {
                self.reset_at = Some(*key);
                self.reference = self.left;
            }
            What::FramePicture(frame, weight) => {
                self.reference = libm::log1p(libm::expm1(self.reference).clamp(0.0, 1.0));
                give(Picture::Frame(frame), self.picture(key.0, weight));
            }
            What::Update(weight) => {
                self.picture(key.0, weight);
            }
            What::Picture(n, weight) => give(Picture::Asked(n), self.picture(key.0, weight)),
        }
    }

    /// The state towards the reference over the time since the last update, and the covariance's own equation
    /// solved exactly.
    fn advance(&mut self, t: i64) -> f64 {
        let dt = (t - self.updated) as f64 * 1e-9;
        let known = self.certainty * dt;
        self.log = self.reference + (self.log - self.reference) / (1.0 + self.covariance * known);
        self.covariance = 1.0 / (1.0 / self.covariance + known);
        self.updated = t;
        dt
    }

    fn picture(&mut self, t: i64, weight: f64) -> f64 {
        let window = self.window();
        let next = (window.frame + 1).min(self.frames.len() - 1);
        self.certainty = self.certainty_of(weight, window.frame, next);
        let dt = self.advance(t);
        self.covariance += self.shared.settings.process_noise * dt;
        let value = libm::expm1(self.log);
        let sound = self.covariance <= 100.0 && (-3.0..=3.0).contains(&value);
        if sound { value } else { libm::expm1(self.reference) }
    }

    /// Before the state is updated: inside an exposure the reference follows the event.
    fn enter(&mut self, (t, pixel): Key, step: f64) {
        let first = &self.window().first;
        let began = self.changed_at == Some((t, pixel)) || self.reset_at == Some((t, pixel));
        if !began && (first.t[0]..=first.t[2]).contains(&t) {
            self.reference += step;
        }
    }

    fn event(&mut self, t: i64, step: f64, noise: f64) {
        let dt = self.advance(t);
        self.log += step;
        self.covariance += self.shared.settings.process_noise * dt;
        self.covariance += noise;
        self.ends = self.ends.map(|end| end + step * self.scale);
        let window = self.window();
        if let Some(w) = window.weight(t) {
            self.reference = libm::log((1.0 - w) * libm::exp(self.ends[0]) + w * libm::exp(self.ends[1]));
        } else if (window.first.t[0]..window.first.t[2]).contains(&t)
            || window.second.is_none()
            || self.changed_at.is_none()
        {
            self.reference = self.ends[0];
        }
    }

    /// Inverse covariance of a frame's value in log(1 + I), between two frames.
    fn certainty_of(&self, weight: f64, frame: usize, next: usize) -> f64 {
        let released = self.shared.settings.variant == Variant::AsReleased;
        // As released, the next frame's value in the square is that of the third frame for ever; its weight
        // is not.
        let square_next = if released && weight > 0.0 { self.stale } else { next };
        let value = |l: usize| self.frames[l] * 255.0;
        let of = |l: usize| self.shared.settings.weight.of(value(l));
        let mixed = 1.0 / ((1.0 - weight) / of(frame) + weight / of(next));
        let slope =
            (1.0 - weight) * (value(frame) + 1.0) / 255.0 + weight * (value(square_next) + 1.0) / 255.0 + 1.0;
        mixed * slope * slope
    }

    /// All steps from the window's first exposure's start to its second's end.
    fn net(&self, window: &Window) -> f64 {
        let Some(second) = &window.second else { return 0.0 };
        match self.shared.settings.variant {
            Variant::AsReleased => self.list.sum(window.first.key[0], second.key[2]),
            Variant::Corrected => self.list.sum((window.first.t[0], 0), (second.t[2] - 1, u32::MAX)),
        }
    }

    /// What steps are multiplied with, so that they lead from one edge to the other; 1 where that would be
    /// out of bounds.
    fn scale_between(&self, window: &Window, left: f64, right: f64) -> f64 {
        let too_large = self.net(window) / (right - left);
        let (least, most) = self.shared.settings.scale;
        if (least..=most).contains(&too_large) { 1.0 / too_large } else { 1.0 }
    }

    /// Log latent values at the start of the window's first exposure and at the end of its second.
    fn edges(&self, window: &Window) -> (f64, Option<f64>) {
        let log = |frame: usize| libm::log1p(self.frames[frame]);
        if !self.shared.settings.deblur {
            return (log(window.frame), window.second.as_ref().map(|_| log(window.frame + 1)));
        }
        match self.shared.settings.variant {
            Variant::AsReleased => {
                let left = log(window.frame)
                    - mean_as_released(self.list, &window.first)
                    - self.list.sum(window.first.key[0], window.first.key[1]);
                let right = |second: &Span| {
                    log(window.frame + 1) - mean_as_released(self.list, second)
                        + self.list.sum(second.key[1], second.key[2])
                };
                (left, window.second.as_ref().map(right))
            }
            Variant::Corrected => {
                let (mean, _) = exact_mean(self.list, &window.first);
                let right = |second: &Span| {
                    let (mean, end) = exact_mean(self.list, second);
                    log(window.frame + 1) - mean + end
                };
                (log(window.frame) - mean, window.second.as_ref().map(right))
            }
        }
    }
}

/// Log of the mean of exp(summed steps) over an exposure, the sum being 0 at its start; and the sum at its
/// end. The double integral, exactly.
pub fn exact_mean(list: PixelList, span: &Span) -> (f64, f64) {
    let [start, _, end] = span.t;
    let (mut last, mut sum, mut area) = (start, 0.0, 0.0);
    for k in list.first_from((start, 0))..list.first_from((end, 0)) {
        area += (list.t[k] - last) as f64 * libm::exp(sum);
        last = list.t[k];
        sum += list.step[k];
    }
    area += (end - last) as f64 * libm::exp(sum);
    (libm::log(area / (end - start) as f64), sum)
}

/// The authors' stand-in for that mean, relative to the middle: a piece of time is weighted with the sum at
/// its far side, the event at the middle counts in both halves, and the area is divided by the time from the
/// first event of the sensor in the exposure to the first after it.
fn mean_as_released(list: PixelList, span: &Span) -> f64 {
    let [start, middle, end] = span.t;
    let (mut last, mut sum, mut area) = (middle, 0.0, 0.0);
    for k in (list.first_from(span.key[0])..list.first_after(span.key[1])).rev() {
        sum -= list.step[k];
        area += (list.t[k] - last).abs() as f64 * libm::exp(sum);
        last = list.t[k];
    }
    area += (start - last).abs() as f64 * libm::exp(sum);
    (last, sum) = (middle, 0.0);
    for k in list.first_from(span.key[1])..list.first_after(span.key[2]) {
        sum += list.step[k];
        area += (list.t[k] - last).abs() as f64 * libm::exp(sum);
        last = list.t[k];
    }
    area += (end - last).abs() as f64 * libm::exp(sum);
    let from = if span.key[0].0 == i64::MAX { start } else { span.key[0].0 };
    let to = if span.key[2].0 == i64::MAX { end } else { span.key[2].0 };
    libm::log(area / (to - from).max(1) as f64)
}

/// The pixel itself and its eight neighbours, each with how far its events are processed.
struct Neighbours<'a> {
    settings: &'a Settings,
    start: Key,
    /// Last event's time of a pixel that had none.
    never: i64,
    /// The pixel itself first; none on the border.
    lists: Option<[(PixelList<'a>, usize); 9]>,
}

impl<'a> Neighbours<'a> {
    fn new(shared: &Shared<'a>, pixel: u32, never: i64) -> Neighbours<'a> {
        let (width, x, y) = (shared.width, pixel % shared.width, pixel / shared.width);
        let inside = x > 0 && y > 0 && x + 1 < width && y + 1 < shared.height;
        let lists = inside.then(|| {
            [(1, 1), (0, 0), (1, 0), (2, 0), (0, 1), (2, 1), (0, 2), (1, 2), (2, 2)].map(|(dx, dy)| {
                let list = shared.events.pixel((y + dy - 1) * width + x + dx - 1);
                (list, list.first_from(shared.course.start))
            })
        });
        Neighbours { settings: shared.settings, start: shared.course.start, never, lists }
    }

    /// Variance that an event adds: for being alone in space, and for coming soon after the pixel's last one.
    fn noise(&mut self, key: Key) -> f64 {
        let Some(lists) = &mut self.lists else { return 2.0 * self.settings.border_noise };
        let (mut latest, mut own) = (self.never, self.never);
        for (n, (list, next)) in lists.iter_mut().enumerate() {
            while *next < list.t.len() && (list.t[*next], list.pixel) < key {
                *next += 1;
            }
            let last = match next.checked_sub(1).map(|k| list.t[k]) {
                Some(t) if (t, list.pixel) >= self.start => t,
                _ => self.never,
            };
            latest = latest.max(last);
            if n == 0 {
                own = last;
            }
        }
        let alone = self.settings.isolated_noise * (key.0 - latest) as f64 * 1e-9;
        let since = key.0 - own;
        alone
            + if since <= self.settings.refractory_ns {
                self.settings.refractory_noise * since as f64 * 1e-9
            } else {
                0.0
            }
    }
}
