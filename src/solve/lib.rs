//! The photocurrent of every pixel that explains its events and its frame values.
//!
//! Idea: a pixel's frames measure how much light it collected, its events when the light changed, both
//! through the sensor's own
//! delays. Inverting the sensor pixel by pixel undoes blur, rolling shutter and event latency at once. Each
//! pixel is one small least-squares
//! problem; this crate cuts a recording into such problems and puts the answers together.
//!
//! - [`solve`] and [`solve_rows`]: the MAP estimate ([`photocurrent_sensor::map`]): all frames and events of
//!   the pixel at once, with knots that are finer
//!   than the events, the exact reset and a prior. Gaps in which events were evidently lost are not used as
//!   constraints ([`photocurrent_sensor::map::losses`]). Its tracks are log-linear
//!   between knots. What the description's `[effects]` did to events and frames is undone by the effects' own
//!   equations ([`photocurrent_sensor::undo`]); those that mix the photocurrent
//!   of neighbours take rounds over whole rows ([`neighbours`]), and those that depend on the load of the
//!   array the events of all its pixels, so that the recording is then solved in one
//!   piece.
//! - [`solve_paper_rows`]: Eq. (13) of Jiang et al., CVPR 2024 ([`photocurrent_sensor::inverse`]), with the
//!   approximations that the paper makes: frames two by two, the pair (l, l+1)
//!   with all events from the start of exposure l to the end of exposure l+1, whose answer counts until
//!   exposure l+1 starts.
//! - [`solve_pixels`]: some pixels of a recording, as [`solve`] has them.
//! - [`solve_pixel`]: one pixel by itself.
//!
//! Frames may have colours, a mosaic of filters, or several pixels on each event pixel: every value of a
//! frame is then a problem of its own with the events of
//! the event pixel that it lies on, posed in that pixel's light ([`shares`]).
//!
//! Limits: colours that change are followed from problem to problem ([`photocurrent_sensor::pooling`] states
//! where that fails). A saturated value counts as the light of saturation, which
//! is a lower bound. A pixel whose problem does not converge falls back to the double-integral estimate and
//! is counted; the map of a solution shows where. Light that no frame of its
//! pixel comes near is held, counted and shown there too.
//!
//! ```
//! use photocurrent_solve::{Exposure, Polarity::On, Sensor, SolveOptions, Source, solve_pixel};
//! let text = "format = \"photocurrent-sensor/1\"
//! [front_end]\ntau_0 = \"20 us\"\nalpha = \"1 ms\"
//! [comparator]\nthreshold_on = 0.2\nthreshold_off = 0.2
//! [readout]\nrefractory = \"10 us\"
//! [frames]\ngain = 1000.0\n";
//! let sensor = Sensor::parse(&Source::new("s.toml", "", text)).unwrap();
//! // Light that rises by a fifth of its logarithm every 2 ms, seen by two exposures of 4 ms.
//! let ms = 1_000_000;
//! let events: Vec<_> = (1..5).map(|k| (k * 2 * ms, On)).collect();
//! let frames = [(Exposure::new(0, 4 * ms), 49.2), (Exposure::new(6 * ms, 10 * ms), 89.6)];
//! let track = solve_pixel(&sensor, &events, &frames, &SolveOptions::default()).unwrap();
//! assert!(track.has_converged && track.photocurrent.windows(2).filter(|pair| pair[1] > pair[0]).count() >
//! track.t_ns.len() / 2);
//! ```

#![warn(unreachable_pub)]

pub mod co_located;
mod elsewhere;
mod host;
mod model;
pub mod neighbours;
mod options;
mod paper;
mod pixel;
pub mod pixel_events;
mod plausible;
mod recording;
pub mod row;
pub mod row_solver;
pub mod settings;
pub mod shares;
mod status;
mod subset;
mod track;

/// What [`solve_pixel`] takes, for programs that depend on this crate alone.
pub use photocurrent_core::{Exposure, Sensor, document::Source, events::Polarity};

pub use elsewhere::RowPicture;
pub use host::Host;
pub use model::Model;
pub use options::{
    FirstKnot, FrontEndModel, Joint, PaperOptions, Precision, ReadoutModel, SolveOptions, TauChoice,
};
pub use photocurrent_sensor::map::Elsewhere;
pub use pixel::solve_pixel;
pub use recording::{
    Pictures, Recording, Solution, elsewhere_bytes, halo, picture_rows, solve, solve_paper_rows, solve_rows,
};
pub use status::{EVENT_RESIDUAL, PLANES, Report, map_meta};
pub use subset::solve_pixels;
pub use track::PixelTrack;
