//! The whole array, step by step in time: comparators, resets, readout, and the charge that frames collect.
//!
//! All pixels take the same step together, so that what couples them (a queue, neighbours, rates) happens in
//! its order. Inside a step the voltage is a parabola, reference and thresholds are straight lines, and an
//! event's instant is where they cross.

use crate::front_end::FrontEnd;
use crate::law::Law;
use crate::light::{Light, Node, cubic_integral};
use crate::random::Random;
use crate::scene::Scene;
use crate::sensor::{Physics, Reset};

/// When things happen, seconds.
#[derive(Clone, Debug)]
pub struct Timing {
    /// Start of the recording.
    pub start: f64,
    pub end: f64,
    /// Is the whole array reset when the recording starts? Otherwise it has been running for some time.
    pub reset_at_start: bool,
    /// Seconds between two nodes of light.
    pub node: f64,
    /// Steps between two nodes of light.
    pub steps: usize,
    /// Exposure of row 0, and of row r later by r x the real row time.
    pub exposures: Vec<[f64; 2]>,
}

/// One event; `t_off` is the off-pixel time as the readout stamps it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Event {
    pub pixel: usize,
    pub on: bool,
    pub t_in: f64,
    pub t_off: f64,
    pub lost: bool,
}

/// What one pixel's comparator remembers.
#[derive(Clone, Debug)]
struct Pixel {
    armed: bool,
    /// Has it never been reset since the recording started?
    fresh: bool,
    blind_until: f64,
    on: f64,
    off: f64,
    /// Thresholds of this pixel without what is redrawn at each reset.
    own: [f64; 2],
    refractory: f64,
    last: f64,
    burst: usize,
    /// Next event that noise fires, rate (Hz, both signs) and sign (0 = either).
    noise_at: f64,
    noise_rate: f64,
    noise_sign: f64,
    telegraph_at: f64,
    telegraph: f64,
    random: Random,
}

/// The state of a run.
struct Array<'a> {
    physics: &'a Physics,
    width: usize,
    height: usize,
    timing: &'a Timing,
    front: FrontEnd,
    pixels: Vec<Pixel>,
    /// Reference at the step's start and end.
    reference: Vec<[f64; 2]>,
    /// Thresholds that count now; infinite while a pixel is blind.
    high: Vec<f64>,
    low: Vec<f64>,
    /// Factor on the thresholds at the step's start and end.
    factor: Vec<[f64; 2]>,
    /// When a pixel must be looked at whatever its voltage does.
    wake: Vec<f64>,
    gradient: Vec<f64>,
    global_rate: f64,
    row_rates: Vec<f64>,
    step: [f64; 2],
    queued: Vec<usize>,
    queue_wait: f64,
    queue_last: f64,
    events: Vec<Event>,
}

/// Runs the sensor: all events, and the charge (photocurrent x s) of each frame and pixel.
pub fn run(
    scene: &Scene,
    physics: &Physics,
    width: usize,
    height: usize,
    timing: &Timing,
    random: &mut Random,
) -> (Vec<Event>, Vec<Vec<f64>>) {
    let n = width * height;
    let burn_in = if timing.reset_at_start { 4e-3 } else { 20e-3 };
    let spacing = timing.node;
    let first = ((timing.start - burn_in) / spacing).floor() as i64;
    let last = (timing.end / spacing).ceil() as i64;
    let mut light = Light::new(scene, physics, width, height);
    let mut nodes: [Node; 4] = std::array::from_fn(|_| light.node());
    for (k, node) in nodes.iter_mut().enumerate() {
        light.fill((first + k as i64 - 1) as f64 * spacing, node);
    }
    let front = FrontEnd::settled(&nodes[1], physics, width);
    let mut array = Array::new(physics, width, height, timing, front, random);
    let mut charge = vec![vec![0.0; n]; timing.exposures.len()];
    let steps = timing.steps;
    let h = spacing / steps as f64;
    for node in first..last {
        let begin = node as f64 * spacing;
        collect(&mut charge, &nodes, begin, physics, timing, width);
        array.look_around(&nodes[1]);
        for k in 0..steps {
            let [from, to] = [k, k + 1].map(|k| k as f64 / steps as f64);
            array.advance([begin + from * spacing, begin + to * spacing], |front| {
                front.step(&nodes, from, to, h, physics)
            });
        }
        nodes.rotate_left(1);
        light.fill((node + 3) as f64 * spacing, &mut nodes[3]);
    }
    let mut events = array.events;
    events.retain(|event| !event.lost && event.t_in >= timing.start && event.t_in <= timing.end);
    (events, charge)
}

/// Adds the light between the nodes 1 and 2 to every frame that is exposed then.
pub fn collect(
    charge: &mut [Vec<f64>],
    nodes: &[Node; 4],
    begin: f64,
    physics: &Physics,
    timing: &Timing,
    width: usize,
) {
    for (charge, [start, end]) in charge.iter_mut().zip(&timing.exposures) {
        for (row, charge) in charge.chunks_exact_mut(width).enumerate() {
            let late = row as f64 * physics.sensor.row_time;
            let from = ((start - physics.exposure_more + late - begin) / timing.node).clamp(0.0, 1.0);
            let to = ((end + late - begin) / timing.node).clamp(0.0, 1.0);
            if to <= from {
                continue;
            }
            let weights = cubic_integral(from, to);
            for (x, charge) in charge.iter_mut().enumerate() {
                let p = row * width + x;
                *charge += timing.node * (0..4).map(|k| weights[k] * nodes[k].frames[p]).sum::<f64>();
            }
        }
    }
}

impl<'a> Array<'a> {
    fn new(
        physics: &'a Physics,
        width: usize,
        height: usize,
        timing: &'a Timing,
        front: FrontEnd,
        random: &mut Random,
    ) -> Self {
        let n = width * height;
        let hot_sign = |random: &mut Random| random.sign();
        let pixel = |p: usize| {
            let mut random = random.split();
            let across = 2.0 * (p % width) as f64 / (width - 1) as f64 - 1.0;
            let (x, y) = (p % width, p / width);
            let own_factor = (1.0 + physics.gradient * across) * law_of_place(physics, x, y, width, height);
            let mut own = [physics.sensor.on, physics.sensor.off]
                .map(|threshold| (threshold * own_factor + physics.mismatch * random.normal()).max(0.02));
            if let Some(Law::RadiusOff { rise }) = physics.law {
                own[1] *= of_radius(rise, x, y, width, height);
            }
            let refractory =
                physics.sensor.refractory * libm::exp(physics.refractory_spread * random.normal());
            let hot = random.chance(physics.hot_share);
            let in_hot_row = physics.hot_rows.contains(&y);
            let hot_rate = if hot { physics.hot_rate } else { 0.0 }
                + if in_hot_row { physics.hot_row_rate } else { 0.0 };
            let noise_sign = if hot { hot_sign(&mut random) } else { 0.0 };
            let noise_rate = hot_rate + physics.background;
            let noise_at = if noise_rate > 0.0 { timing.start - 1.0 } else { f64::INFINITY };
            let flips = match physics.law {
                Some(Law::Telegraph { share, .. }) if random.chance(share) => random.sign(),
                _ => 0.0,
            };
            Pixel {
                armed: false,
                fresh: true,
                blind_until: if timing.reset_at_start { timing.start } else { f64::NEG_INFINITY },
                on: own[0],
                off: own[1],
                own,
                refractory,
                last: f64::NEG_INFINITY,
                burst: 0,
                noise_at,
                noise_rate,
                noise_sign,
                telegraph_at: f64::NEG_INFINITY,
                telegraph: flips,
                random,
            }
        };
        let pixels: Vec<Pixel> = (0..n).map(pixel).collect();
        let wake = pixels.iter().map(|pixel| pixel.blind_until).collect();
        Self {
            physics,
            width,
            height,
            timing,
            reference: front.now.iter().map(|v| [*v; 2]).collect(),
            front,
            pixels,
            high: vec![f64::INFINITY; n],
            low: vec![f64::INFINITY; n],
            factor: vec![[1.0; 2]; n],
            wake,
            gradient: vec![0.0; n],
            global_rate: 0.0,
            row_rates: vec![0.0; height],
            step: [0.0; 2],
            queued: Vec::new(),
            queue_wait: 0.0,
            queue_last: f64::NEG_INFINITY,
            events: Vec::new(),
        }
    }

    /// Looks at what changes slowly: rates decay, and the picture has a gradient.
    fn look_around(&mut self, node: &Node) {
        match self.physics.law {
            Some(Law::GlobalRate { memory, .. } | Law::RowRate { memory, .. }) => {
                let decay = libm::exp(-self.timing.node / memory);
                self.global_rate *= decay;
                self.row_rates.iter_mut().for_each(|rate| *rate *= decay);
            }
            Some(Law::SpatialGradient { .. }) => {
                let (w, h) = (self.width, self.height);
                for p in 0..w * h {
                    let (x, y) = (p % w, p / w);
                    let (left, right) = (x.max(1) - 1, (x + 1).min(w - 1));
                    let (above, below) = (y.max(1) - 1, (y + 1).min(h - 1));
                    let dx =
                        (node.settled[y * w + right] - node.settled[y * w + left]) / (right - left) as f64;
                    let dy =
                        (node.settled[below * w + x] - node.settled[above * w + x]) / (below - above) as f64;
                    self.gradient[p] = libm::sqrt(dx * dx + dy * dy);
                }
            }
            _ => {}
        }
    }

    /// One step from `step[0]` to `step[1]` (s); `front` moves the front end.
    fn advance(&mut self, step: [f64; 2], front: impl Fn(&mut FrontEnd)) {
        self.step = step;
        let [begin, end] = step;
        let h = end - begin;
        self.shake();
        front(&mut self.front);
        let n = self.pixels.len();
        let (leak, parasitic) = (self.physics.leak * self.physics.sensor.on * h, self.physics.parasitic * h);
        let of_rows = match self.physics.law {
            Some(Law::RowLeak { rate }) => rate * self.physics.sensor.on * h / (self.height - 1) as f64,
            _ => 0.0,
        };
        for p in 0..n {
            let start = self.reference[p][1];
            let leak = leak + of_rows * (p / self.width) as f64;
            self.reference[p] = [start, start - leak - parasitic * self.front.light[p]];
        }
        let moving = self.physics.drift != 0.0 || self.physics.law.as_ref().is_some_and(Law::moves);
        if moving {
            for p in 0..n {
                self.factor[p] = [self.factor[p][1], self.factor_at(p, end)];
            }
        }
        for p in 0..n {
            let moved = self.front.now[p] - self.reference[p][1];
            let factor = self.factor[p][1];
            if moved >= self.high[p] * factor || -moved >= self.low[p] * factor || self.wake[p] <= end {
                self.look_at(p);
            }
        }
        self.serve();
    }

    /// The kick of a frame's readout, for the rows whose readout falls into this step.
    fn shake(&mut self) {
        let Some([jump, period, phase, row_time]) = self.physics.coupling else { return };
        for row in 0..self.height {
            let since = |t: f64| ((t - phase - row as f64 * row_time) / period).floor();
            if since(self.step[1]) > since(self.step[0]) {
                self.front.kick(row * self.width..(row + 1) * self.width, jump);
            }
        }
    }

    /// The factor on both thresholds of a pixel at time `t`.
    fn factor_at(&mut self, p: usize, t: f64) -> f64 {
        let drift = 1.0 + self.physics.drift * t;
        let pixel = &mut self.pixels[p];
        let law = match &self.physics.law {
            Some(Law::Hysteresis { rise, decay }) => rise * libm::exp(-(t - pixel.last) / decay),
            Some(Law::FrameKick { rise, decay }) => {
                let exposures = &self.timing.exposures;
                let period = exposures[1][0] - exposures[0][0];
                let since = (t - exposures[0][1] - (p / self.width) as f64 * self.physics.sensor.row_time)
                    .rem_euclid(period);
                rise * libm::exp(-since / decay)
            }
            Some(Law::Fatigue { rise, most, gap }) if t - pixel.last < *gap => {
                rise * pixel.burst.min(*most) as f64
            }
            Some(Law::Ripple { depth, frequency, phase }) => {
                depth * libm::sin(2.0 * std::f64::consts::PI * frequency * t + phase)
            }
            Some(Law::SpatialGradient { rise, scale }) => rise * (self.gradient[p] / scale).min(2.0),
            Some(Law::GlobalRate { rise, mean, .. }) => rise * self.global_rate / mean,
            Some(Law::RowRate { rise, mean, .. }) => rise * self.row_rates[p / self.width] / mean,
            Some(Law::Light { rise, middle }) => rise * libm::log(self.front.light[p] / middle),
            Some(Law::Telegraph { jump, dwell, .. }) if pixel.telegraph != 0.0 => {
                while pixel.telegraph_at <= t {
                    if pixel.telegraph_at.is_finite() {
                        pixel.telegraph = -pixel.telegraph;
                    } else {
                        pixel.telegraph_at = t;
                    }
                    pixel.telegraph_at += pixel.random.exponential(*dwell);
                }
                jump * pixel.telegraph
            }
            Some(Law::Lag { rise }) => {
                rise * (self.front.settled[p] - self.front.first[p]).abs().min(0.3) / 0.1
            }
            Some(Law::TimeStep { rise, at }) if t >= *at => *rise,
            Some(Law::Warming { rise, decay }) => rise * libm::exp(-t / decay),
            _ => 0.0,
        };
        drift * (1.0 + law).max(0.2)
    }

    /// A value that runs straight from `ends[0]` to `ends[1]` during the step, at `t`.
    fn within(&self, ends: [f64; 2], t: f64) -> f64 {
        ends[0] + (ends[1] - ends[0]) * (t - self.step[0]) / (self.step[1] - self.step[0])
    }

    fn voltage(&self, p: usize, t: f64) -> f64 {
        self.front.within(p, (t - self.step[0]) / (self.step[1] - self.step[0]))
    }

    /// The first crossing from `from` to `to` and its sign, if there is one.
    fn crossing(&self, p: usize, from: f64, to: f64) -> Option<(f64, f64)> {
        [(1.0, self.high[p]), (-1.0, self.low[p])].into_iter().find_map(|(sign, threshold)| {
            let beyond = |t: f64| {
                sign * (self.voltage(p, t) - self.within(self.reference[p], t))
                    - threshold * self.within(self.factor[p], t)
            };
            let (a, b) = (beyond(from), beyond(to));
            if a >= 0.0 {
                Some((from, sign))
            } else if b >= 0.0 {
                // The chord's root, then twice that of the chord to the end on the other side: the curve is a
                // slight one.
                let (mut left, mut right) = ((from, a), (to, b));
                let mut root = from;
                for _ in 0..3 {
                    root = left.0 + (right.0 - left.0) * left.1 / (left.1 - right.1);
                    let value = beyond(root);
                    *if value < 0.0 { &mut left } else { &mut right } = (root, value);
                    if left.1 == right.1 {
                        break;
                    }
                }
                Some((root, sign))
            } else {
                None
            }
        })
    }

    /// Everything that happens to one pixel during this step.
    fn look_at(&mut self, p: usize) {
        let mut from = self.step[0];
        let end = self.step[1];
        loop {
            if self.pixels[p].armed {
                let noise = self.pixels[p].noise_at;
                let crossing = self.crossing(p, from, end);
                match crossing {
                    Some((t, sign)) if t <= noise => from = self.fire(p, t, sign),
                    _ if noise <= end => {
                        let pixel = &mut self.pixels[p];
                        let sign =
                            if pixel.noise_sign == 0.0 { pixel.random.sign() } else { pixel.noise_sign };
                        from = self.fire(p, noise.max(from), sign);
                    }
                    _ => break,
                }
            } else {
                let until = self.pixels[p].blind_until;
                if self.physics.sensor.reset == Reset::AdvanceLossy
                    && !self.pixels[p].fresh
                    && let Some((t, sign)) = self.crossing(p, from, until.min(end))
                {
                    self.move_reference(p, t, sign);
                    from = t;
                } else if until <= end {
                    from = until.max(from);
                    self.arm(p, from);
                } else {
                    break;
                }
            }
        }
        let pixel = &self.pixels[p];
        self.wake[p] = if pixel.armed { pixel.noise_at } else { pixel.blind_until };
    }

    /// Moves the reference by the threshold that was crossed.
    fn move_reference(&mut self, p: usize, t: f64, sign: f64) {
        let threshold = if sign > 0.0 { self.pixels[p].on } else { self.pixels[p].off };
        let by = sign * threshold * self.within(self.factor[p], t);
        self.reference[p] = self.reference[p].map(|v| v + by);
    }

    /// Ends the blind time at `t`.
    fn arm(&mut self, p: usize, t: f64) {
        let physics = self.physics;
        let fresh = std::mem::replace(&mut self.pixels[p].fresh, false);
        if physics.sensor.reset == Reset::Resample || fresh {
            let (old, new) = (self.within(self.reference[p], t), self.voltage(p, t));
            let memory = if fresh { 0.0 } else { physics.memory };
            let by = (1.0 - memory) * (new - old);
            self.reference[p] = self.reference[p].map(|v| v + by);
        }
        self.factor[p] = [self.factor_at(p, t); 2];
        let light = self.front.light[p];
        let pixel = &mut self.pixels[p];
        let mut sigma = physics.sensor.threshold_noise;
        if let Some(Law::DimNoise { share, middle }) = physics.law {
            let own = share * libm::sqrt(middle / light).min(3.0) * 0.5 * (pixel.own[0] + pixel.own[1]);
            sigma = libm::hypot(sigma, own);
        }
        [pixel.on, pixel.off] = pixel.own.map(|own| (own + sigma * pixel.random.normal()).max(0.2 * own));
        if pixel.noise_rate > 0.0 {
            // The noise has no memory: waiting begins anew whenever the pixel can fire.
            pixel.noise_at = t + pixel.random.exponential(1.0 / pixel.noise_rate);
        }
        pixel.armed = true;
        (self.high[p], self.low[p]) = (pixel.on, pixel.off);
    }

    /// Fires; gives the instant from which the pixel is to be looked at again.
    fn fire(&mut self, p: usize, t: f64, sign: f64) -> f64 {
        let physics = self.physics;
        let (x, y) = (p % self.width, p / self.width);
        let slope = (self.front.now[p] - self.front.before[p]).abs() / (self.step[1] - self.step[0]);
        if physics.sensor.reset != Reset::Resample {
            self.move_reference(p, t, sign);
        }
        let (mut decided, mut shown_late, mut hidden_late) = (t, 0.0, 0.0);
        match &physics.law {
            Some(Law::SlowComparator { strength, most }) => {
                decided += (strength / libm::sqrt(slope.max(1e-9))).min(*most)
            }
            Some(Law::PolarityDelay { delay }) if sign < 0.0 => shown_late = *delay,
            Some(Law::ParityDelay { delay }) if !y.is_multiple_of(2) => shown_late = *delay,
            Some(Law::DelayWave { depth, frequency, phase }) => {
                let swing = libm::sin(2.0 * std::f64::consts::PI * frequency * t + phase);
                shown_late = 0.5 * depth * (1.0 + swing);
            }
            Some(Law::NeighbourDelay { delay, window }) => {
                let near =
                    (-1i64..=1).flat_map(|dy| (-1i64..=1).map(move |dx| (x as i64 + dx, y as i64 + dy)));
                let inside = near.filter(|(u, v)| {
                    (0..self.width as i64).contains(u) && (0..self.height as i64).contains(v)
                });
                let mut others =
                    inside.map(|(u, v)| v as usize * self.width + u as usize).filter(|q| *q != p);
                if others.any(|q| t - self.pixels[q].last < *window) {
                    shown_late = *delay;
                }
            }
            Some(Law::RowReset { per_row }) => hidden_late = per_row * y as f64,
            Some(Law::GlobalRate { memory, .. }) => self.global_rate += 1.0 / memory,
            Some(Law::RowRate { memory, .. }) => self.row_rates[y] += 1.0 / memory,
            _ => {}
        }
        let gap = if let Some(Law::Fatigue { gap, .. }) = physics.law { gap } else { 0.0 };
        let light = self.front.light[p];
        let pixel = &mut self.pixels[p];
        let latency = physics.sensor.latency_min
            + pixel.random.exponential(physics.sensor.latency_more).min(8.0 * physics.sensor.latency_more);
        let loss = match physics.law {
            Some(Law::RowLoss { most }) => most * y as f64 / (self.height - 1) as f64,
            _ => physics.loss,
        };
        let lost = pixel.random.chance(loss);
        pixel.burst = if t - pixel.last < gap { pixel.burst + 1 } else { 1 };
        pixel.last = t;
        pixel.armed = false;
        let off = decided + latency;
        pixel.blind_until = off + hidden_late + pixel.refractory / (1.0 + physics.refractory_light * light);
        self.events.push(Event {
            pixel: p,
            on: sign > 0.0,
            t_in: decided + shown_late,
            t_off: off + shown_late,
            lost,
        });
        if physics.queue.is_some() {
            self.queued.push(self.events.len() - 1);
        }
        if physics.sensor.reset != Reset::AdvanceLossy {
            (self.high[p], self.low[p]) = (f64::INFINITY, f64::INFINITY);
        }
        t
    }

    /// Lets the events of this step wait for each other, in the order in which they happened.
    fn serve(&mut self) {
        let Some(queue) = self.physics.queue else { return };
        let mut queued = std::mem::take(&mut self.queued);
        queued.sort_by(|a, b| self.events[*a].t_in.total_cmp(&self.events[*b].t_in));
        for index in queued.drain(..) {
            let event = &mut self.events[index];
            self.queue_wait = (self.queue_wait + queue.service - (event.t_in - self.queue_last)).max(0.0);
            self.queue_last = event.t_in;
            if queue.shown {
                event.t_off += self.queue_wait;
            }
            let pixel = &mut self.pixels[event.pixel];
            pixel.blind_until += self.queue_wait;
            self.wake[event.pixel] = pixel.blind_until;
        }
        self.queued = queued;
    }
}

/// The factor on a pixel's thresholds that depends on where it is.
fn law_of_place(physics: &Physics, x: usize, y: usize, width: usize, height: usize) -> f64 {
    match &physics.law {
        Some(Law::RowParity { skew }) => 1.0 + if y.is_multiple_of(2) { *skew } else { -skew },
        Some(Law::ColumnBlock { width, factors }) => factors[x / width],
        Some(Law::Radius { rise }) => of_radius(*rise, x, y, width, height),
        Some(Law::RowBand { rise, first, last }) if (*first..=*last).contains(&y) => 1.0 + rise,
        Some(Law::ColumnWave { depth, period, phase }) => {
            1.0 + depth * libm::sin(2.0 * std::f64::consts::PI * x as f64 / period + phase)
        }
        _ => 1.0,
    }
}

/// A factor that grows with the square of the distance from the centre.
fn of_radius(rise: f64, x: usize, y: usize, width: usize, height: usize) -> f64 {
    let (cx, cy) = (0.5 * (width - 1) as f64, 0.5 * (height - 1) as f64);
    let (dx, dy) = (x as f64 - cx, y as f64 - cy);
    1.0 + rise * (2.0 * (dx * dx + dy * dy) / (cx * cx + cy * cy) - 1.0)
}
