//! Whose photocurrent an event pixel sees where effects mix that of neighbours, as the solver needs it.
//!
//! The kernels of all effects are joined into one ([`crate::forward::neighbours::joined`]). A frame pixel and
//! an event pixel at the same place need not see the same thing: with a shift by three pixels none of the
//! light of a frame pixel reaches the event pixel there. So a frame pixel is solved with the events of that
//! event pixel which sees it with the largest weight ([`Mixing::columns_right`], [`Mixing::rows_down`]), and
//! the rest of the kernel, around that weight, is what has to be corrected for.
//!
//! Limits: one domain for all kernels; taps that together weigh less than [`LEAST_PART`] are left out; a
//! frame pixel whose event pixel would lie beyond the array has no events.

use crate::effects::{Effect, Kernel, Tap};
use crate::forward::neighbours::{TwoDomains, joined, mixed_log, stand_in};

/// Taps are left out while their weights sum to less than this part of all: a blur's far taps are many, and
/// even next to pixels a hundred times as bright their photocurrent is a percent.
const LEAST_PART: f64 = 1e-4;

/// The joined kernel of some effects.
#[derive(Clone, Debug, PartialEq)]
pub struct Mixing {
    kernel: Kernel,
    /// Column and row of the largest weight, less those of the event pixel.
    centre: (i32, i32),
}

impl Mixing {
    /// Of some effects; none where no photocurrent is mixed.
    ///
    /// # Errors
    /// When their kernels act in two domains.
    pub fn new(effects: &[Box<dyn Effect>]) -> Result<Option<Mixing>, TwoDomains> {
        Ok(joined(effects)?.and_then(Mixing::of))
    }

    fn of(mut kernel: Kernel) -> Option<Mixing> {
        let distance = |tap: &Tap| i64::from(tap.dx).pow(2) + i64::from(tap.dy).pow(2);
        // Stable sorts of numbers that are the same everywhere: heaviest first, the nearest of equal ones
        // first.
        kernel
            .taps
            .sort_by(|a, b| b.weight.abs().total_cmp(&a.weight.abs()).then(distance(a).cmp(&distance(b))));
        let (sum, all): (f64, f64) =
            kernel.taps.iter().fold((0.0, 0.0), |(sum, all), tap| (sum + tap.weight, all + tap.weight.abs()));
        let mut left = 0.0;
        while let Some(last) = kernel.taps.last()
            && kernel.taps.len() > 1
            && left + last.weight.abs() < LEAST_PART * all
        {
            left += last.weight.abs();
            kernel.taps.pop();
        }
        let rest: f64 = kernel.taps.iter().map(|tap| tap.weight).sum();
        if sum != 0.0 && rest != 0.0 {
            kernel.taps.iter_mut().for_each(|tap| tap.weight *= sum / rest);
        }
        let centre = kernel.taps.first().map(|tap| (tap.dx, tap.dy))?;
        Some(Mixing { kernel, centre })
    }

    /// Columns from a pixel to the event pixel that sees most of its photocurrent, to the right.
    pub fn columns_right(&self) -> i32 {
        -self.centre.0
    }

    /// Rows from a pixel to that event pixel, downwards.
    pub fn rows_down(&self) -> i32 {
        -self.centre.1
    }

    /// How many rows away from a pixel the others are that its event pixel sees.
    pub fn reach(&self) -> u32 {
        self.kernel.taps.iter().map(|tap| tap.dy.abs_diff(self.centre.1)).max().unwrap_or(0)
    }

    /// Log photocurrent that event pixel (x, y) sees at `count` instants; `log_light` gives that of another
    /// pixel, by column and row: beyond the edge the nearest one stands in.
    pub fn seen(
        &self,
        (x, y): (u32, u32),
        (width, height): (u32, u32),
        count: usize,
        mut log_light: impl FnMut(u32, u32, &mut Vec<f64>),
    ) -> Vec<f64> {
        mixed_log(&self.kernel, count, |tap, out| {
            log_light(
                stand_in(x as usize, tap.dx, width as usize) as u32,
                stand_in(y as usize, tap.dy, height as usize) as u32,
                out,
            );
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::effects::Domain;
    use crate::effects::blur::Blur;
    use crate::effects::crosstalk::Crosstalk;
    use crate::effects::lateral_inhibition::LateralInhibition;
    use crate::effects::misalignment::Misalignment;
    use crate::forward::tests::plane::event_plane;

    fn mixing(effects: Vec<Box<dyn Effect>>) -> Mixing {
        Mixing::new(&effects).unwrap().unwrap()
    }

    #[test]
    fn each_pixel_sees_what_the_simulator_mixes() {
        let (width, height) = (9, 7);
        let plane: Vec<f64> = (0..width * height).map(|at| 5.0 + f64::from(at * 37 % 23)).collect();
        let check = |effects: Vec<Box<dyn Effect>>| {
            let expected = event_plane(&effects, width as usize, height as usize, &plane).unwrap();
            let mixing = mixing(effects);
            for (x, y) in (0..height).flat_map(|y| (0..width).map(move |x| (x, y))) {
                let found = mixing.seen((x, y), (width, height), 1, |x, y, out| {
                    out.push(libm::log(plane[(y * width + x) as usize]))
                });
                let expected = libm::log(expected[(y * width + x) as usize]);
                // What is left out weighs a ten-thousandth, of neighbours at most five times as bright.
                assert!((found[0] - expected).abs() < 1e-3, "({x}, {y}): {} {expected}", found[0]);
            }
        };
        check(vec![Box::new(Crosstalk { fraction: 0.2 })]);
        check(vec![Box::new(Blur { sigma_px: 0.8 })]);
        check(vec![Box::new(Misalignment { shift_x: 1.25, shift_y: -2.5 })]);
        check(vec![Box::new(LateralInhibition { fraction: 0.4 })]);
    }

    #[test]
    fn a_pixel_has_the_events_of_the_one_that_sees_it() {
        // Details of the frames lie three columns further right and two rows further up in the events.
        let shifted = mixing(vec![Box::new(Misalignment { shift_x: 3.25, shift_y: -2.0 })]);
        assert_eq!((shifted.columns_right(), shifted.rows_down(), shifted.reach()), (3, -2, 0));
        let soft = mixing(vec![Box::new(Blur { sigma_px: 0.5 })]);
        assert_eq!((soft.columns_right(), soft.rows_down()), (0, 0));
        assert!((2..=3).contains(&soft.reach()), "{}", soft.reach());
    }

    #[test]
    fn what_is_left_out_is_light_and_the_sum_stays() {
        let kernel = Blur { sigma_px: 1.0 }.kernel().unwrap();
        let trimmed = Mixing::of(kernel.clone()).unwrap().kernel;
        assert!(trimmed.taps.len() < kernel.taps.len() && trimmed.domain == Domain::Linear);
        assert!((trimmed.taps.iter().map(|tap| tap.weight).sum::<f64>() - 1.0).abs() < 1e-12);
    }

    #[test]
    fn two_domains_are_refused_and_no_kernel_is_no_mixing() {
        let both: Vec<Box<dyn Effect>> =
            vec![Box::new(Crosstalk { fraction: 0.2 }), Box::new(LateralInhibition { fraction: 0.4 })];
        assert!(Mixing::new(&both).is_err());
        assert_eq!(Mixing::new(&[]), Ok(None));
    }
}
