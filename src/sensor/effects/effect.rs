//! What an effect is: a set of hooks into the simulated pixel, each of which does nothing unless the effect
//! says otherwise.
//!
//! The simulator asks every effect at every place of the chain, in the order of the catalogue. An effect
//! keeps no state of its own: what it may remember is in [`History`], what it may draw comes from a stream of
//! its own, so results depend neither on row bands nor on threads. A draw that belongs to the pixel and not
//! to the event (a mismatch, a hot pixel) is `site.random("purpose")`, which starts the same stream at every
//! call.

use crate::comparator::PixelEvent;
use crate::front_end::FrontEnd;
use photocurrent_core::Exposure;
use photocurrent_core::random::Random;

/// The pixel an effect is asked about.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Site {
    /// Column, from 0.
    pub x: u32,
    /// Row, from 0.
    pub y: u32,
    /// Columns of the array, at least 1.
    pub width: u32,
    /// Rows of the array, at least 1.
    pub height: u32,
    /// The seed of the run.
    pub seed: u64,
}

impl Site {
    /// The stream that belongs to this pixel and `purpose` (usually the effect's id): the same numbers at
    /// every call.
    pub fn random(&self, purpose: &str) -> Random {
        Random::new(self.seed, &[u64::from(self.x), u64::from(self.y), purpose_code(purpose)])
    }

    /// The column from -1 (first) to +1 (last); 0 for an array of one column.
    pub fn across(&self) -> f64 {
        if self.width < 2 { 0.0 } else { 2.0 * f64::from(self.x) / f64::from(self.width - 1) - 1.0 }
    }

    /// Which eighth of the array's width, from 0.
    pub fn column_block(&self) -> u32 {
        8 * self.x / self.width.max(1)
    }

    /// Distance from the array's centre over the distance of a corner pixel: 0 to 1; 0 for a single pixel.
    pub fn radius(&self) -> f64 {
        let (half_x, half_y) =
            (0.5 * f64::from(self.width.saturating_sub(1)), 0.5 * f64::from(self.height.saturating_sub(1)));
        let corner = libm::sqrt(half_x * half_x + half_y * half_y);
        let (dx, dy) = (f64::from(self.x) - half_x, f64::from(self.y) - half_y);
        if corner == 0.0 { 0.0 } else { libm::sqrt(dx * dx + dy * dy) / corner }
    }
}

/// The row of a stream shared by a whole row: what `hot_rows` or a skew per row draws from. The same numbers
/// at every call.
pub fn row_random(seed: u64, y: u32, purpose: &str) -> Random {
    Random::new(seed, &[u64::MAX, u64::from(y), purpose_code(purpose)])
}

/// The streams of one pixel and effect, one per hook.
#[derive(Clone, Debug)]
pub(crate) struct Streams {
    pub thresholds: Random,
    pub reference: Random,
    pub latency: Random,
    pub spontaneous: Random,
    pub keeps: Random,
    pub stamp: Random,
}

impl Streams {
    pub(crate) fn new(site: &Site, effect: &str) -> Streams {
        let stream = |hook: u64| {
            Random::new(site.seed, &[u64::from(site.x), u64::from(site.y), purpose_code(effect), hook])
        };
        Streams {
            thresholds: stream(1),
            reference: stream(2),
            latency: stream(3),
            spontaneous: stream(4),
            keeps: stream(5),
            stamp: stream(6),
        }
    }
}

/// A number for a text: FNV-1a.
fn purpose_code(purpose: &str) -> u64 {
    purpose
        .bytes()
        .fold(0xcbf2_9ce4_8422_2325, |code, byte| (code ^ u64::from(byte)).wrapping_mul(0x0100_0000_01b3))
}

/// What an effect may know of the pixel's past.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct History {
    /// The most recent event, lost ones included: a lost event has reset its pixel.
    pub last_event: Option<PixelEvent>,
    /// Events so far.
    pub events: u64,
    /// Position of the last event in its burst, from 1: a run of events of one polarity, which ends after
    /// [`BURST_GAP_NS`] without one. 0 before any event.
    pub burst_index: u32,
    /// Photocurrent in the logarithm when the last event left, or at the start.
    pub light: f64,
}

impl History {
    /// With one more event, which left when the photocurrent in the logarithm was `light`.
    pub(crate) fn with(&self, event: PixelEvent, light: f64) -> History {
        let goes_on = self.last_event.is_some_and(|last| {
            last.polarity == event.polarity && event.t_in_ns - last.t_in_ns <= BURST_GAP_NS
        });
        let burst_index = if goes_on { self.burst_index + 1 } else { 1 };
        History { last_event: Some(event), events: self.events + 1, burst_index, light }
    }
}

/// Time without an event that ends a burst, nanoseconds.
pub const BURST_GAP_NS: i64 = 10_000_000;

/// Both contrast thresholds, positive, natural-log units.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Thresholds {
    /// Of an ON event.
    pub on: f64,
    /// Of an OFF event.
    pub off: f64,
}

/// The domain in which neighbours' light is summed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Domain {
    /// Photocurrents add: optics and charge.
    Linear,
    /// Logarithms add: circuits behind the logarithm.
    Log,
}

/// One neighbour's part in a pixel's light.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Tap {
    /// Column of the neighbour minus that of the pixel.
    pub dx: i32,
    /// Row of the neighbour minus that of the pixel.
    pub dy: i32,
    /// Its weight; in the linear domain weights are not negative, so that light stays positive.
    pub weight: f64,
}

/// The event path sees a weighted sum of neighbours' light. Beyond the array's edge the nearest pixel stands
/// in.
#[derive(Clone, Debug, PartialEq)]
pub struct Kernel {
    /// Where the sum is taken.
    pub domain: Domain,
    /// The parts, the pixel itself included.
    pub taps: Vec<Tap>,
}

/// The pole behind the low-pass: `tau = tau_s + tau_light_s / i`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SecondPole {
    /// The part that light does not change, seconds, at least zero.
    pub tau_s: f64,
    /// Seconds times photocurrent unit, at least zero.
    pub tau_light_s: f64,
}

/// How the low-pass answers to its input.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Drive {
    /// `dV/dt = (L - V) / tau`, Eq. (3).
    #[default]
    SmallSignal,
    /// `dV/dt = (1 - exp(-(L - V))) / tau`: the exponential transistor of the feedback loop.
    LargeSignal,
}

/// The front end with everything that effects may add to it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FrontEndModel {
    /// The low-pass of Eq. (3).
    pub low_pass: FrontEnd,
    /// A further pole, or none.
    pub second_pole: Option<SecondPole>,
    /// Answer of the low-pass to large steps.
    pub drive: Drive,
    /// Largest rise of the low-pass, ln/s, positive; infinite = no limit.
    pub slew_up_per_s: f64,
    /// Largest fall of the low-pass, ln/s, positive; infinite = no limit.
    pub slew_down_per_s: f64,
    /// Time constant of a high-pass before the comparator, seconds, positive; infinite = none.
    pub high_pass_s: f64,
}

impl FrontEndModel {
    /// The low-pass alone.
    pub fn plain(low_pass: FrontEnd) -> FrontEndModel {
        let none = f64::INFINITY;
        FrontEndModel {
            low_pass,
            second_pole: None,
            drive: Drive::SmallSignal,
            slew_up_per_s: none,
            slew_down_per_s: none,
            high_pass_s: none,
        }
    }

    /// Whether nothing but the low-pass is there: then the voltage has a closed form.
    pub fn is_plain(&self) -> bool {
        *self == FrontEndModel::plain(self.low_pass)
    }
}

/// What a sudden disturbance moves.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ImpulseTarget {
    /// The front-end voltage, which then settles back with its time constant.
    FrontEnd,
    /// The comparator's input, for good: until the next reset takes a new reference.
    Comparator,
}

/// A sudden disturbance of the voltage.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Impulse {
    /// When.
    pub t_ns: i64,
    /// By how much, natural-log units; positive pushes towards an ON event.
    pub change: f64,
    /// What is moved.
    pub target: ImpulseTarget,
}

/// A steady drift of voltage against reference, positive towards ON events.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Leak {
    /// ln/s.
    pub constant_per_s: f64,
    /// ln/s per photocurrent unit; the photocurrent is that of the light, without dark current.
    pub per_photocurrent_per_s: f64,
}

/// Latency added to the time between firing and leaving the array. Both parts delay the reset.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Latency {
    /// The part that the off-pixel stamp shows, nanoseconds, not negative.
    pub shown_ns: i64,
    /// The part that no stamp shows, nanoseconds, not negative.
    pub hidden_ns: i64,
}

/// An event that comes without a crossing.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Spontaneous {
    /// When; a pixel that is blind then stays silent.
    pub t_ns: i64,
    /// +1 for ON, -1 for OFF.
    pub polarity: i8,
}

/// A row whose exposure is asked about.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct RowSite {
    /// Row, from 0.
    pub y: u32,
    /// Rows of the array.
    pub height: u32,
    /// Frame, from 0.
    pub frame: usize,
    /// Delay from one row to the next as the recording states it, nanoseconds.
    pub row_time_ns: i64,
}

/// A frame value on its way from charge to digital number.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Reading {
    /// Frame, from 0.
    pub frame: usize,
    /// Photocurrent times seconds of the frame before, 0 for the first.
    pub previous_charge: f64,
    /// Stated DN per photocurrent and second.
    pub gain: f64,
    /// Stated DN of darkness.
    pub black_level: f64,
    /// Stated DN of a full pixel, infinite when unknown.
    pub saturation: f64,
}

/// An event with its pixel, for hooks that see the whole array.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ArrayEvent {
    /// Column.
    pub x: u32,
    /// Row.
    pub y: u32,
    /// The event with true times.
    pub event: PixelEvent,
}

/// What of an effect is drawn, so that it cannot be undone: by how much measurements are trusted less, and
/// what is known all the same.
#[derive(Default)]
pub struct Chance {
    /// Standard deviation of a pixel's own thresholds, natural-log units.
    pub of_pixels: f64,
    /// Standard deviation of the threshold of each event, natural-log units.
    pub of_events: f64,
    /// Standard deviation of a stamp, seconds.
    pub of_stamps_s: f64,
    /// Standard deviation of the values of a frame, as a share of the signal.
    pub of_frames: f64,
    /// The part of the effect that is no chance.
    pub known: Option<Box<dyn Effect>>,
}

/// A non-ideality of the sensor. Every hook defaults to "nothing".
///
/// `random` is a stream of this pixel, effect and hook that goes on from call to call. Times are true
/// nanoseconds.
pub trait Effect: Send + Sync {
    /// The catalogue id.
    fn id(&self) -> &'static str;

    /// The weighted sum of neighbours' light that the event path sees.
    fn kernel(&self) -> Option<Kernel> {
        None
    }

    /// The photocurrent that enters the logarithm at `t_ns`, from photocurrent `i`; positive. Linear in `i`
    /// and constant in time, or [`Effect::light_step_ns`] says how finely the light must be sampled.
    fn event_light(&self, _site: &Site, _t_ns: i64, i: f64) -> f64 {
        i
    }

    /// The longest step, nanoseconds, over which [`Effect::event_light`] of linear light may be taken as
    /// linear; none = any.
    fn light_step_ns(&self) -> Option<i64> {
        None
    }

    /// Photocurrent that [`Effect::event_light`] adds to the event path, whatever it sees and when: known
    /// exactly, so a solver may take the sum as its unknown. At least 0.
    fn added_photocurrent(&self) -> f64 {
        0.0
    }

    /// Changes the front end of the pixel, once.
    fn front_end(&self, _site: &Site, _model: &mut FrontEndModel) {}

    /// Adds sudden disturbances between `start_ns` and `end_ns`, in any order.
    fn impulses(&self, _site: &Site, _start_ns: i64, _end_ns: i64, _out: &mut Vec<Impulse>) {}

    /// Changes the thresholds that hold from the reset at `t_reset_ns` on; asked once at the start (without a
    /// last event) and after each event. Without a form of its own, adds [`Effect::offsets`].
    fn thresholds(
        &self,
        site: &Site,
        _history: &History,
        _random: &mut Random,
        _t_reset_ns: i64,
        thresholds: &mut Thresholds,
    ) {
        if let Some(offsets) = self.offsets(site) {
            thresholds.on += offsets.on;
            thresholds.off += offsets.off;
        }
    }

    /// What is added to the pixel's thresholds at every reset, natural-log units, where that is all that
    /// [`Effect::thresholds`] does: the simulator takes it once a pixel.
    fn offsets(&self, _site: &Site) -> Option<Thresholds> {
        None
    }

    /// Do thresholds go on to change while the pixel waits for its next event ([`Effect::waiting`])?
    fn waits(&self) -> bool {
        false
    }

    /// Changes the thresholds that [`Effect::thresholds`] gave to those that hold at `t_ns`, before the next
    /// event.
    fn waiting(&self, _site: &Site, _history: &History, _t_ns: i64, _thresholds: &mut Thresholds) {}

    /// The drift of the voltage against the reference. `stated` are the description's thresholds.
    fn leak(&self, _site: &Site, _stated: &Thresholds) -> Leak {
        Leak::default()
    }

    /// The reference after a reset, natural-log units. `ideal` is what the reset rule gives, `before` the
    /// reference of the event that caused it.
    fn reference(
        &self,
        _site: &Site,
        _history: &History,
        _random: &mut Random,
        ideal: f64,
        _before: f64,
    ) -> f64 {
        ideal
    }

    /// The refractory period after an event, nanoseconds, not negative. `i` is the photocurrent in the
    /// logarithm when the event leaves.
    fn refractory_ns(&self, _site: &Site, _i: f64, refractory_ns: i64) -> i64 {
        refractory_ns
    }

    /// Latency added to that of the readout.
    fn latency(&self, _site: &Site, _random: &mut Random, _t_in_ns: i64) -> Latency {
        Latency::default()
    }

    /// Adds events without a crossing between `start_ns` and `end_ns`, in any order. An armed pixel fires and
    /// resets.
    fn spontaneous(
        &self,
        _site: &Site,
        _random: &mut Random,
        _start_ns: i64,
        _end_ns: i64,
        _out: &mut Vec<Spontaneous>,
    ) {
    }

    /// Whether the event reaches the recording. One that does not has still reset its pixel. `history`: up to
    /// the event before.
    fn keeps(&self, _site: &Site, _history: &History, _random: &mut Random, _event: &PixelEvent) -> bool {
        true
    }

    /// Turns true times into recorded ones.
    fn stamp(&self, _site: &Site, _random: &mut Random, _event: &mut PixelEvent) {}

    /// The same effect knowing the load: everything that all pixels fired in a pass before, in order of true
    /// off-pixel time. Events that are lost ([`Effect::keeps`]) are among them, as they have gone the whole
    /// way to the reset of their pixel and are lost behind it. The simulator then runs the pixels again, and
    /// reports anew what they did, until nothing moves. None = the load does not matter.
    ///
    /// An informed effect answers otherwise in [`Effect::latency`] only, by load, pixel and instant without a
    /// random number: the simulator sees by that which pixels another load moves.
    fn informed(&self, _events: &[ArrayEvent]) -> Option<Box<dyn Effect>> {
        None
    }

    /// When the row is really exposed, given when the recording says it is.
    fn exposure(&self, _row: &RowSite, exposure: Exposure) -> Exposure {
        exposure
    }

    /// The charge, photocurrent times seconds, that is read out of a pixel that collected `charge`.
    fn charge(&self, _site: &Site, _reading: &Reading, charge: f64) -> f64 {
        charge
    }

    /// The digital number, given what it would be without the effect.
    fn dn(&self, _site: &Site, _reading: &Reading, dn: f64) -> f64 {
        dn
    }

    /// What cannot be undone because it is drawn; none = the hooks above say it all, and [`crate::undo`]
    /// takes it off again.
    fn chance(&self) -> Option<Chance> {
        None
    }
}
