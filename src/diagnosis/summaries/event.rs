//! Single events against what their neighbours in time and the frames foretell.
//!
//! *Jackknife*: a cubic through the two events before and the two after gives a voltage at the event; less the thresholds' sum there, in thresholds. *Anchored*: what the
//! anchoring to frames adds to an event's step, in thresholds. Both are averaged over everything that an error could depend on.

use super::{Bins, Summaries, View, bin};
use rayon::prelude::*;

/// What means are taken by, and how many bins it has.
const BY: [(&str, usize); 10] =
    [("order", 4), ("row", 3), ("column", 3), ("time", 4), ("phase", 8), ("light", 4), ("gap", 7), ("load", 3), ("slope", 4), ("index", 4)];
const FREQUENCIES_HZ: [f64; 5] = [30.0, 60.0, 100.0, 200.0, 400.0];

struct Sums {
    jackknife: Vec<Bins>,
    anchored: Vec<Bins>,
    waves: Vec<(f64, f64, f64)>,
}

impl Sums {
    fn new() -> Sums {
        let bins = || BY.iter().map(|(_, n)| Bins::new(*n)).collect();
        Sums { jackknife: bins(), anchored: bins(), waves: vec![(0.0, 0.0, 0.0); FREQUENCIES_HZ.len()] }
    }
}

pub(super) fn put(view: &View<'_>, into: &mut Summaries) {
    let load = Load::of(view);
    let places: Vec<usize> = (0..view.bands.len()).collect();
    let parts: Vec<Sums> = places
        .par_chunks(64)
        .map(|places| {
            let mut sums = Sums::new();
            places.iter().for_each(|&n| pixel(view, n, &load, &mut sums));
            sums
        })
        .collect();
    let mut sums = Sums::new();
    for part in &parts {
        for (own, other) in sums.jackknife.iter_mut().zip(&part.jackknife) {
            own.merge(other);
        }
        for (own, other) in sums.anchored.iter_mut().zip(&part.anchored) {
            own.merge(other);
        }
        for (own, other) in sums.waves.iter_mut().zip(&part.waves) {
            *own = (own.0 + other.0, own.1 + other.1, own.2 + other.2);
        }
    }
    for (k, (name, bins)) in BY.iter().enumerate() {
        for n in 0..*bins {
            into.put(format!("event.jackknife.{name}_{n}"), 10.0 * sums.jackknife[k].mean(n));
            into.put(format!("event.anchored.{name}_{n}"), 10.0 * sums.anchored[k].mean(n));
            if matches!(*name, "order" | "light" | "gap" | "slope" | "time") {
                into.put(format!("event.scatter.{name}_{n}"), libm::log(sums.jackknife[k].rms(n) + 0.01));
            }
        }
    }
    for (frequency, wave) in FREQUENCIES_HZ.iter().zip(&sums.waves) {
        into.put(format!("event.wave_{frequency}"), 10.0 * libm::sqrt(wave.0 * wave.0 + wave.1 * wave.1) / (wave.2 + 20.0));
    }
}

/// How busy the sampled part of the array is, by windows of 100 us.
struct Load {
    counts: Vec<u32>,
    edges: [f64; 2],
}

const WINDOW_NS: i64 = 100_000;

impl Load {
    fn of(view: &View<'_>) -> Load {
        let windows = ((view.case.span.1 - view.case.span.0) / WINDOW_NS + 1).clamp(1, 1 << 22) as usize;
        let mut counts = vec![0_u32; windows];
        for pixel in &view.sample.pixels {
            for event in view.case.events.of(*pixel as usize) {
                let at = (event.t_in_ns - view.case.span.0) / WINDOW_NS;
                if let Some(count) = usize::try_from(at).ok().and_then(|at| counts.get_mut(at)) {
                    *count += 1;
                }
            }
        }
        let mut sorted: Vec<f64> = counts.iter().map(|count| f64::from(*count)).collect();
        sorted.sort_by(f64::total_cmp);
        let edges = [super::quantile(&sorted, 0.5), super::quantile(&sorted, 0.85)];
        Load { counts, edges }
    }

    fn class(&self, t_s: f64) -> usize {
        let at = (t_s * 1e9) as usize / WINDOW_NS as usize;
        bin(f64::from(self.counts.get(at).copied().unwrap_or(0)), &self.edges)
    }
}

fn pixel(view: &View<'_>, n: usize, load: &Load, sums: &mut Sums) {
    let band = &view.bands[n];
    let events = band.at_event.len();
    if events < 3 {
        return;
    }
    let pixel = view.sample.pixels[n] as usize;
    let (x, y) = view.case.place(pixel);
    let scales = view.scales;
    let zero = view.case.span.0;
    let polarities: Vec<f64> =
        view.case.events.of(pixel).iter().filter(|e| e.t_in_ns > zero && e.t_in_ns < view.case.span.1).map(|e| f64::from(e.polarity)).collect();
    if polarities.len() != events {
        return;
    }
    let threshold = |k: usize| if polarities[k] > 0.0 { view.nominal.pixel.threshold_on } else { view.nominal.pixel.threshold_off };
    let t: Vec<f64> = band.at_event.iter().map(|at| band.t[*at as usize]).collect();
    let v: Vec<f64> = band.at_event.iter().map(|at| band.v[*at as usize]).collect();
    let anchored: Vec<f64> = band.at_event.iter().zip(&v).map(|(at, v)| band.anchored_voltage(view.nominal, *at as usize) - v).collect();
    let middle = libm::log(scales.light);
    let third = |at: u32, of: u32| (3 * at / of.max(1)) as usize;
    let mut index = 0;
    for k in 1..events {
        let gap = t[k] - t[k - 1];
        let same = polarities[k] == polarities[k - 1];
        index = if same && gap < 3e-3 { index + 1 } else { 0 };
        let slope = (band.slope[band.at_event[k] as usize] / scales.slope_per_s).abs();
        let phase = ((t[k] - scales.frame_phase_s) / scales.frame_period_s).rem_euclid(1.0);
        let bins = [
            if polarities[k] > 0.0 { 0 } else { 2 } + usize::from(same),
            third(y, view.case.extent.height),
            third(x, view.case.extent.width),
            ((4.0 * t[k] / scales.duration_s) as usize).min(3),
            ((8.0 * phase) as usize).min(7),
            bin(v[k] - middle, &[-0.5, 0.0, 0.5]),
            bin(gap, &[60e-6, 150e-6, 300e-6, 700e-6, 2e-3, 6e-3]),
            load.class(t[k]),
            bin(slope, &[0.1, 0.3, 0.8]),
            usize::min(index, 3),
        ];
        let z = (polarities[k] * (anchored[k] - anchored[k - 1]) / threshold(k)).clamp(-2.0, 2.0);
        for (sums, at) in sums.anchored.iter_mut().zip(bins) {
            sums.add(at, z);
        }
        for (wave, frequency) in sums.waves.iter_mut().zip(FREQUENCIES_HZ) {
            let angle = std::f64::consts::TAU * frequency * t[k];
            *wave = (wave.0 + z * polarities[k] * libm::cos(angle), wave.1 + z * polarities[k] * libm::sin(angle), wave.2 + 1.0);
        }
        if k >= 2 && k + 2 < events && t[k + 2] - t[k - 2] < 12e-3 {
            let foretold = through([t[k - 2], t[k - 1], t[k + 1], t[k + 2]], [v[k - 2], v[k - 1], v[k + 1], v[k + 2]], t[k]);
            let z = (polarities[k] * (foretold - v[k]) / threshold(k)).clamp(-2.0, 2.0);
            for (sums, at) in sums.jackknife.iter_mut().zip(bins) {
                sums.add(at, z);
            }
        }
    }
}

/// The cubic through four points, at a fifth instant.
fn through(t: [f64; 4], v: [f64; 4], at: f64) -> f64 {
    let mut sum = 0.0;
    for a in 0..4 {
        let mut share = 1.0;
        for b in 0..4 {
            if a != b {
                share *= (at - t[b]) / (t[a] - t[b]);
            }
        }
        sum += share * v[a];
    }
    sum
}

#[cfg(test)]
mod tests {
    use super::through;

    #[test]
    fn a_cubic_is_met_everywhere() {
        let cubic = |t: f64| 1.0 - 2.0 * t + 0.5 * t * t - 0.25 * t * t * t;
        let t = [-1.0, 0.3, 1.1, 4.0];
        assert!((through(t, t.map(cubic), 0.7) - cubic(0.7)).abs() < 1e-12);
    }
}
