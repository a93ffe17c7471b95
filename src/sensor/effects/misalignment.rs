//! Misalignment: what a frame shows at a pixel, the events show a little to the side of it.
//!
//! Two optical paths, different pixel pitches or a wrong registration shift the event image against the frame
//! image. An edge at column `x` of a frame is at `x + shift_x` in the events, so the event pixel sees the
//! light of `(x - shift_x, y - shift_y)`, taken bilinearly between four pixels. Typical: 0.1 to 3 pixels.
//!
//! Parameters: `shift_x` (positive = right), `shift_y` (positive = down, the direction of growing rows),
//! pixels. At one constant speed of the whole image it cannot be distinguished from a clock offset: two
//! directions or speeds separate them.
//!
//! Source: geometry. Limits: a translation, no rotation or scale; between pixels bilinear interpolation
//! softens the image, at half a pixel by a sigma of half a pixel; beyond the array's edge the nearest pixel
//! stands in.

use super::sought::{Search, Size, Sought};
use super::{Domain, Effect, EffectDecl, EffectKind, Kernel, ParameterDecl, Parameters, Stage, Tap, Unit};

const SHIFT_X: ParameterDecl = ParameterDecl {
    name: "shift_x",
    unit: Unit::Number("px"),
    null: Some(0.0),
    allowed: (-1000.0, 1000.0),
    plausible: (-4.0, 4.0),
    about: "column in the events minus column in the frames, of the same detail; positive = events lie to \
            the right; absent = 0",
};

/// The catalogue entry.
pub const KIND: EffectKind = EffectKind {
    decl: EffectDecl {
        id: "misalignment",
        stage: Stage::Light,
        about: "Events are shifted against frames",
        equation: "i_events(x, y) = i_frames(x - shift_x, y - shift_y)",
        parameters: &[
            SHIFT_X,
            ParameterDecl {
                name: "shift_y",
                about: "row in the events minus row in the frames, of the same detail; positive = events \
                        lie below; absent = 0",
                ..SHIFT_X
            },
        ],
        covariate: "spatial_gradient",
        signature: "frames differ from what events predict in proportion to the gradient along one \
                    direction of the image",
        confused_with: &["clock_offset", "row_time", "blur"],
        source: "geometry",
        apart: &[],
        search: Search::For(&[
            Sought { typical: Size::Fixed(0.6), ..Sought::both("shift_x") },
            Sought { typical: Size::Fixed(0.6), ..Sought::both("shift_y") },
        ]),
    },
    build,
};

fn build(parameters: &Parameters) -> Result<Box<dyn Effect>, String> {
    let (shift_x, shift_y) = (parameters.get("shift_x"), parameters.get("shift_y"));
    if shift_x.is_none() && shift_y.is_none() {
        return Err("`effects.misalignment` needs `shift_x` or `shift_y`, or both".to_owned());
    }
    Ok(Box::new(Misalignment { shift_x: shift_x.unwrap_or(0.0), shift_y: shift_y.unwrap_or(0.0) }))
}

/// A shift of the event image against the frames.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Misalignment {
    /// Column in the events minus column in the frames, pixels.
    pub shift_x: f64,
    /// Row in the events minus row in the frames, pixels.
    pub shift_y: f64,
}

impl Effect for Misalignment {
    fn id(&self) -> &'static str {
        KIND.decl.id
    }

    fn kernel(&self) -> Option<Kernel> {
        let mut taps = Vec::new();
        for (dy, weight_y) in between(-self.shift_y) {
            for (dx, weight_x) in between(-self.shift_x) {
                if weight_x * weight_y > 0.0 {
                    taps.push(Tap { dx, dy, weight: weight_x * weight_y });
                }
            }
        }
        (*self != Misalignment::default()).then_some(Kernel { domain: Domain::Linear, taps })
    }
}

/// The two pixels around `at`, with the weights of linear interpolation.
fn between(at: f64) -> [(i32, f64); 2] {
    let below = libm::floor(at);
    [(below as i32, 1.0 - (at - below)), (below as i32 + 1, at - below)]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::forward::tests::plane::event_plane;

    fn seen(shift_x: f64, shift_y: f64, light: impl Fn(f64, f64) -> f64) -> f64 {
        let kernel = Misalignment { shift_x, shift_y }.kernel().unwrap();
        assert_eq!(kernel.domain, Domain::Linear);
        kernel.taps.iter().map(|tap| tap.weight * light(f64::from(tap.dx), f64::from(tap.dy))).sum()
    }

    #[test]
    fn a_linear_ramp_moves_exactly() {
        let ramp = |x: f64, y: f64| 10.0 + 2.0 * x - 3.0 * y;
        for (shift_x, shift_y) in [(0.25, 0.0), (0.0, -0.5), (1.75, 2.5), (-3.125, 0.375)] {
            assert!((seen(shift_x, shift_y, ramp) - ramp(-shift_x, -shift_y)).abs() < 1e-12);
        }
    }

    #[test]
    fn events_lie_where_the_shift_says() {
        // A bright spot one column to the left in the frames is seen here when events are shifted by one to
        // the right.
        assert_eq!(seen(1.0, 0.0, |x, y| if (x, y) == (-1.0, 0.0) { 5.0 } else { 0.0 }), 5.0);
        assert_eq!(seen(0.0, -2.0, |x, y| if (x, y) == (0.0, 2.0) { 5.0 } else { 0.0 }), 5.0);
    }

    #[test]
    fn an_edge_of_the_frames_lies_further_right_in_the_events() {
        let plane: Vec<f64> = (0..24).map(|at| if at % 8 < 3 { 1.0 } else { 9.0 }).collect();
        let effects: [Box<dyn Effect>; 1] = [Box::new(Misalignment { shift_x: 2.25, shift_y: 0.0 })];
        let events = event_plane(&effects, 8, 3, &plane).unwrap();
        assert_eq!(events[8..16], [1.0, 1.0, 1.0, 1.0, 1.0, 7.0, 9.0, 9.0]);
    }

    #[test]
    fn a_whole_shift_needs_one_pixel_and_none_no_kernel() {
        assert_eq!(
            Misalignment { shift_x: 2.0, shift_y: -1.0 }.kernel().unwrap().taps,
            [Tap { dx: -2, dy: 1, weight: 1.0 }]
        );
        assert_eq!(Misalignment::default().kernel(), None);
    }
}
