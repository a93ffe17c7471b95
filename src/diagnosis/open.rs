//! What an effect that nobody has named depends on.
//!
//! The best sensor so far is tried with thresholds a little higher and lower, and with stamps a little earlier and later. What each event costs then ([`crate::mismatch`]) says which way
//! it would have to be moved. Where these wishes differ from those of a simulated recording of the same sensor, bin by bin of some covariate, the sensor has
//! a threshold or a delay that depends on it; no form is presumed ([`crate::locate`]).

use crate::candidates::{CANDIDATES, Trial};
use crate::case::Case;
use crate::covariates::Surroundings;
use crate::locate::{Channel, Curve, Side, Wanted, scan};
use crate::mismatch::for_each_cost;
use crate::refit::Refit;
use crate::scene::Scene;
use crate::under::Under;
use rayon::prelude::*;

/// By how much thresholds and stamps are tried off, in strengths of their candidates.
const TRIED: [(&str, f64); 2] = [("threshold_scale", 0.4), ("clock_offset", 0.16)];
/// The least mean curvature of the cost, in units of an event: flatter ones say nothing.
const LEAST_CURVATURE: f64 = 0.01;

/// The curves of thresholds and stamps over every covariate, most significant first.
///
/// # Errors
/// When effects cannot be combined.
pub fn unknown(refit: &Refit<'_>, seed: u64) -> Result<Vec<Curve>, String> {
    let (light, recording, here) = wishes(refit, refit.case, refit.base)?;
    let own = refit.behind_mixing();
    let control = Refit { case: &recording, base: &own, ..*refit };
    let (again, _, there) = wishes(&control, &recording, &own)?;
    let front_end = refit.base.nominal.pixel.front_end;
    let tau = (front_end.tau_0_s, front_end.alpha_s);
    let (around, around_again) = (Surroundings::new(refit.case, refit.sample, &light, tau), Surroundings::new(&recording, refit.sample, &again, tau));
    let recorded = Side { events: &[], frames: &[], wanted: &here, surroundings: &around };
    Ok(scan(&recorded, &Side { events: &[], frames: &[], wanted: &there, surroundings: &around_again }, seed))
}

/// The light, what the sensor records of it, and what each recorded event would have.
fn wishes(refit: &Refit<'_>, case: &Case, base: &Trial) -> Result<(Scene, Case, Vec<Wanted>), String> {
    let look = |trial: &Trial| -> Result<(Scene, Case, Vec<f64>), String> {
        let under = Under::new(case, trial, refit.frame_noise)?;
        let (light, recording) = under.corrected(refit.sample, refit.scene, refit.priors, refit.turns)?;
        let mut costs = Vec::new();
        for &pixel in &refit.sample.pixels {
            for_each_cost(case.events.of(pixel as usize), recording.events.of(pixel as usize), |cost| costs.push(cost));
        }
        Ok((light, recording, costs))
    };
    let trials: Vec<Trial> = TRIED
        .iter()
        .flat_map(|(id, by)| [-by, *by].map(|strength| (*id, strength)))
        .map(|(id, strength)| {
            let mut trial = base.clone();
            let candidate = CANDIDATES.iter().find(|candidate| candidate.id == id).ok_or_else(|| format!("{id} is no candidate"))?;
            candidate.put_on(&mut trial, strength, refit.scales);
            Ok(trial)
        })
        .collect::<Result<_, String>>()?;
    let (light, recording, plain) = look(base)?;
    let tried = trials.par_iter().map(|trial| look(trial).map(|(_, _, costs)| costs)).collect::<Result<Vec<_>, String>>()?;
    // The lowest point of a parabola for each event, with the mean curvature of all.
    let wanted = |which: usize, unit: f64| -> Vec<f64> {
        let (less, more) = (&tried[2 * which], &tried[2 * which + 1]);
        let curvature = (0..plain.len()).map(|n| less[n] + more[n] - 2.0 * plain[n]).sum::<f64>() / f64::max(plain.len() as f64, 1.0);
        let per = unit / f64::max(curvature, LEAST_CURVATURE);
        (0..plain.len()).map(|n| 0.5 * (less[n] - more[n]) * per).collect()
    };
    let unit = |which: usize| {
        let (id, by) = TRIED[which];
        let candidate = CANDIDATES.iter().find(|candidate| candidate.id == id);
        candidate.map_or(by, |candidate| candidate.value(by, refit.scales, &base.nominal) - candidate.nominal_value(&base.nominal))
    };
    let (thresholds, stamps) = (wanted(0, unit(0)), wanted(1, unit(1)));
    let events = refit.sample.pixels.iter().flat_map(|&pixel| case.events.of(pixel as usize).iter().map(move |event| (pixel, event)));
    let all = events.zip(thresholds).zip(stamps);
    let one = |(((pixel, event), threshold), stamps): (((u32, &crate::case::Recorded), f64), f64)| Wanted {
        pixel,
        t_ns: event.t_in_ns,
        polarity: event.polarity,
        threshold,
        stamps,
    };
    Ok((light, recording, all.map(one).collect()))
}

/// What a curve is of, in words.
pub fn insertion(channel: Channel) -> &'static str {
    match channel {
        Channel::Threshold | Channel::Extra | Channel::Missing => "comparator",
        Channel::Stamps | Channel::Delay => "time",
        Channel::Frames => "exposure",
    }
}
