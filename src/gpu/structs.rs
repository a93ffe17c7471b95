//! What processor and card share, written once: a structure as Rust lays it out, and its text in WGSL.

use bytemuck::{Pod, Zeroable};

/// Structures of numbers of 32 bits, with `WGSL`, the text of all of them, in order.
macro_rules! shared {
    ($($(#[$about:meta])* struct $name:ident { $($(#[$note:meta])* $field:ident: $type:ident,)* })*) => {
        $(
            $(#[$about])*
            #[derive(Clone, Copy, Debug, Default, Pod, Zeroable)]
            #[repr(C)]
            pub(crate) struct $name {
                $($(#[$note])* pub(crate) $field: $type,)*
            }
        )*

        /// These structures in WGSL.
        pub(crate) const WGSL: &str = concat!($(
            "struct ", stringify!($name), " {\n",
            $("    ", stringify!($field), ": ", stringify!($type), ",\n",)*
            "}\n",
        )*);
    };
}

shared! {
    /// Of a call.
    struct Params {
        /// Pixels of this call: from `first` to before `end`.
        first: u32,
        end: u32,
        /// Cells of a column.
        cells: u32,
        /// Always 0, which no compiler can see.
        zero: u32,
        /// Of the last pass: what is wanted of it.
        with_evidence: u32,
        with_variance: u32,
        unused_0: u32,
        unused_1: u32,
    }

    /// Of a call that integrates light.
    struct MeansCall {
        pixels: u32,
        /// Of each pixel.
        exposures: u32,
        /// Exposures of a thread.
        piece: u32,
        is_linear: u32,
        with_spread: u32,
        unused_0: u32,
        unused_1: u32,
        unused_2: u32,
    }

    /// What makes a pixel's track of its answer.
    struct Track {
        /// Light of the pixel over that of the answer.
        ratio: f32,
        /// Light is held there.
        most: f32,
        sigma_factor: f32,
        unused: f32,
    }

    /// One pixel's constants.
    struct Pixel {
        /// First cell, and steps.
        cell: u32,
        steps: u32,
        max_iterations: u32,
        /// Most steps of each half of a second start; 0 = none is tried.
        second_steps: u32,
        start: f32,
        /// No log light may be above it.
        limit: f32,
        tolerance: f32,
        tau_0_s: f32,
        alpha_s: f32,
        on: f32,
        off: f32,
        /// Standard deviation of an event, as a part of its threshold.
        event: f32,
        reference_variance: f32,
        threshold_variance: f32,
        no_event_sigma: f32,
        stamp_sigma_s: f32,
        /// Local variance: square of the floor; Student's t: degrees of freedom times the variance.
        spread: f32,
        /// Local variance: memory, s; Student's t: degrees of freedom and one.
        tails: f32,
        second_event: f32,
        least_misfit: f32,
        most_misfit: f32,
        second_keeps: f32,
        /// Events and frame values, and events by polarity.
        measured: f32,
        rising: f32,
        falling: f32,
    }

    /// An answer: where it stands and what that costs.
    struct Place {
        u0: f32,
        reference: f32,
        on: f32,
        off: f32,
        /// 0 while the no-event constraint does not count.
        no_event_sigma: f32,
        /// Squares of events, frames and offsets, over their variances.
        measured: f32,
        no_event_square: f32,
        event_square: f32,
        frame_square: f32,
        largest: f32,
        /// The step of the largest square.
        largest_step: u32,
        events: u32,
        frames: u32,
        iterations: u32,
        status: u32,
    }

    /// A pixel on its way.
    struct State {
        here: Place,
        /// The first answer, while a second start is on its way.
        plain: Place,
        is_stepping: u32,
        /// 0: first start; 1, 2: the halves of the second; 3: done.
        stage: u32,
        second: u32,
        attempts: u32,
        damping: f32,
        cost: f32,
        /// What the prior expects of the thresholds.
        expected_on: f32,
        expected_off: f32,
        /// Of an event, at this stage.
        event: f32,
        /// Which of two columns holds the light.
        column: u32,
        evidence: f32,
    }
}
