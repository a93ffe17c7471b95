//! What a sensor would show at recorded instants when the light is known: how far each recorded event is from
//! the crossing of its threshold, and what the frames should read.
//!
//! The instants are those of a recording; the sensor may be another one than that which made it. Nothing here
//! is random.

use crate::array::{Event, Timing, collect};
use crate::frames;
use crate::front_end::FrontEnd;
use crate::light::{Light, Node};
use crate::scene::Scene;
use crate::sensor::{Physics, Reset};

/// A recording whose light is known.
#[derive(Clone, Copy)]
pub struct Known<'a> {
    pub scene: &'a Scene,
    pub timing: &'a Timing,
    pub size: [usize; 2],
    /// All events, in the order of their instants in each pixel.
    pub events: &'a [Event],
    /// Are in-pixel times recorded? Otherwise they are the off-pixel times less the mean latency.
    pub has_t_in: bool,
}

/// What is seen of it.
pub struct Seen {
    /// `p (V - V_ref) - threshold` at each event (ln); NaN where the reference is not known.
    pub residuals: Vec<f64>,
    /// `|dV/dt|` at each event, ln/s.
    pub slopes: Vec<f64>,
    /// Digital numbers of the frames.
    pub frames: Vec<Vec<f64>>,
}

/// What is followed of one pixel.
#[derive(Clone)]
struct Pixel {
    /// Its events that are still to come, by number.
    events: std::collections::VecDeque<usize>,
    /// Reference at the step's start.
    reference: f64,
    is_known: bool,
    /// When the reference is renewed next.
    renewed: f64,
    /// When the next event fired.
    fires: f64,
}

struct Replay<'a> {
    known: &'a Known<'a>,
    physics: &'a Physics,
    front: FrontEnd,
    pixels: Vec<Pixel>,
    /// When something happens next in each pixel.
    next: Vec<f64>,
    waits: Vec<f64>,
    step: [f64; 2],
    seen: Seen,
}

/// Evaluates the crossings and the frames of `physics` at the recorded instants.
pub fn observe(known: &Known, physics: &Physics) -> Seen {
    let (timing, [width, height]) = (known.timing, known.size);
    let burn_in = if timing.reset_at_start { 4e-3 } else { 20e-3 };
    let spacing = timing.node;
    let first = ((timing.start - burn_in) / spacing).floor() as i64;
    let last = (timing.end / spacing).ceil() as i64;
    let mut light = Light::new(known.scene, physics, width, height);
    let mut nodes: [Node; 4] = std::array::from_fn(|_| light.node());
    for (k, node) in nodes.iter_mut().enumerate() {
        light.fill((first + k as i64 - 1) as f64 * spacing, node);
    }
    let mut replay = Replay::new(known, physics, FrontEnd::settled(&nodes[1], physics, width));
    let mut charge = vec![vec![0.0; width * height]; timing.exposures.len()];
    // Steps twice as long as those of a recording: what counts is the difference of two sensors.
    let steps = (timing.steps / 2).max(1);
    let h = spacing / steps as f64;
    for node in first..last {
        let begin = node as f64 * spacing;
        collect(&mut charge, &nodes, begin, physics, timing, width);
        for k in 0..steps {
            let [from, to] = [k, k + 1].map(|k| k as f64 / steps as f64);
            replay.step = [begin + from * spacing, begin + to * spacing];
            replay.couple();
            replay.front.step(&nodes, from, to, h, physics);
            replay.advance();
        }
        nodes.rotate_left(1);
        light.fill((node + 3) as f64 * spacing, &mut nodes[3]);
    }
    Seen { frames: frames::expected(&charge, physics, width), ..replay.seen }
}

impl<'a> Replay<'a> {
    fn new(known: &'a Known<'a>, physics: &'a Physics, front: FrontEnd) -> Self {
        let renewed = if known.timing.reset_at_start { known.timing.start } else { f64::INFINITY };
        let pixel =
            Pixel { events: [].into(), reference: 0.0, is_known: false, renewed, fires: f64::INFINITY };
        let mut pixels = vec![pixel; known.size[0] * known.size[1]];
        for (number, event) in known.events.iter().enumerate() {
            pixels[event.pixel].events.push_back(number);
        }
        let next = vec![f64::NEG_INFINITY; pixels.len()];
        let n = known.events.len();
        let seen = Seen { residuals: vec![f64::NAN; n], slopes: vec![0.0; n], frames: Vec::new() };
        let waits = waits(known, physics);
        let mut replay = Self { known, physics, front, pixels, next, waits, step: [0.0; 2], seen };
        (0..replay.pixels.len()).for_each(|p| replay.await_event(p));
        replay
    }

    /// Notes when the pixel's next event fired.
    fn await_event(&mut self, p: usize) {
        let number = self.pixels[p].events.front();
        self.pixels[p].fires = number.map_or(f64::INFINITY, |n| self.fired(&self.known.events[*n]));
    }

    /// When what is stamped `t` happened, of the row of `pixel`.
    fn instant(&self, t: f64, pixel: usize) -> f64 {
        let row = (pixel / self.known.size[0]) as f64;
        (t - self.physics.clock_offset - self.physics.skew_per_row * row) / (1.0 + self.physics.clock_rate)
    }

    fn fired(&self, event: &Event) -> f64 {
        let latency = self.physics.sensor.latency_min + self.physics.sensor.latency_more;
        self.instant(if self.known.has_t_in { event.t_in } else { event.t_off - latency }, event.pixel)
    }

    /// The step that a frame's readout gives the voltage of a row.
    fn couple(&mut self) {
        let Some([jump, period, phase, row_time]) = self.physics.coupling else { return };
        let [width, height] = self.known.size;
        for row in 0..height {
            let since = |t: f64| ((t - phase - row as f64 * row_time) / period).floor();
            if since(self.step[1]) > since(self.step[0]) {
                self.front.kick(row * width..(row + 1) * width, jump);
            }
        }
    }

    /// All that happens during the step.
    fn advance(&mut self) {
        let [begin, end] = self.step;
        let (leak, parasitic) = (self.physics.leak * self.physics.sensor.on, self.physics.parasitic);
        for p in 0..self.pixels.len() {
            let leak = leak + parasitic * self.front.light[p];
            while self.next[p] <= end {
                let Pixel { renewed, fires, .. } = self.pixels[p];
                if renewed <= fires && renewed <= end {
                    self.renew(p, renewed.max(begin), leak);
                } else if fires <= end {
                    self.meet(p, fires.max(begin), leak);
                }
                self.next[p] = f64::min(self.pixels[p].renewed, self.pixels[p].fires);
            }
            if leak != 0.0 {
                self.pixels[p].reference -= leak * (end - begin);
            }
        }
    }

    fn voltage(&self, p: usize, t: f64) -> f64 {
        self.front.within(p, (t - self.step[0]) / (self.step[1] - self.step[0]))
    }

    /// Renews the reference at `t`.
    fn renew(&mut self, p: usize, t: f64, leak: f64) {
        let v = self.voltage(p, t);
        let pixel = &mut self.pixels[p];
        let old = pixel.reference - leak * (t - self.step[0]);
        let left = if pixel.is_known { self.physics.memory * (old - v) } else { 0.0 };
        pixel.reference = v + left + leak * (t - self.step[0]);
        pixel.is_known = true;
        pixel.renewed = f64::INFINITY;
    }

    /// Notes how far an event is from its threshold.
    fn meet(&mut self, p: usize, t: f64, leak: f64) {
        let (known, physics) = (self.known, self.physics);
        let Some(number) = self.pixels[p].events.pop_front() else { return };
        self.await_event(p);
        let event = &known.events[number];
        let v = self.voltage(p, t);
        let [begin, end] = self.step;
        self.seen.slopes[number] = (self.front.now[p] - self.front.before[p]).abs() / (end - begin);
        let pixel = &mut self.pixels[p];
        // An event within the blind time has no crossing to be held against.
        if pixel.is_known && pixel.renewed.is_infinite() {
            let (sign, threshold) =
                if event.on { (1.0, physics.sensor.on) } else { (-1.0, physics.sensor.off) };
            let across = 2.0 * (p % known.size[0]) as f64 / (known.size[0] - 1) as f64 - 1.0;
            let factor = (1.0 + physics.gradient * across) * (1.0 + physics.drift * t);
            let moved = v - (pixel.reference - leak * (t - begin));
            self.seen.residuals[number] = sign * moved - threshold * factor;
        }
        if physics.sensor.reset == Reset::Resample {
            let blind = physics.sensor.refractory / (1.0 + physics.refractory_light * self.front.light[p]);
            self.pixels[p].renewed = self.instant(event.t_off, p) + blind + self.waits[number];
        } else {
            // The reference has moved to where the voltage met the threshold.
            self.renew(p, t, leak);
        }
    }
}

/// How much later than its stamps say each event is served.
fn waits(known: &Known, physics: &Physics) -> Vec<f64> {
    let mut waits = vec![0.0; known.events.len()];
    let Some(queue) = physics.queue.filter(|queue| !queue.shown) else { return waits };
    let mut order: Vec<usize> = (0..waits.len()).collect();
    order.sort_by(|a, b| known.events[*a].t_in.total_cmp(&known.events[*b].t_in));
    let (mut wait, mut last) = (0.0, f64::NEG_INFINITY);
    for number in order {
        let t = known.events[number].t_in;
        wait = f64::max(wait + queue.service - (t - last), 0.0);
        last = t;
        waits[number] = wait;
    }
    waits
}
