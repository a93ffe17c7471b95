//! Holds some frames out, so that a solution can be tested on frames it never saw.
//!
//! Every n-th frame goes to `held`, the others to `kept`; or, with `keep_every`, every n-th to `kept`. A
//! solver gets `kept`; a scorer compares `held` with what is rendered at its exposures. The very first and
//! the very last frame are never held out: what lies between two kept frames is interpolated and constrained
//! from both sides, what lies beyond the last one is not, and would measure something else.
//!
//! Limits: events stay whole. A held frame's light is still seen by the events of its time, as it should be.

use photocurrent_core::{Context, Decl, FrameSequence, FramesMeta, Grain, Meta, Node, NodeError, PortMetas};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::sync::Arc;

/// Parameters of `split/frames`.
#[derive(Clone, Debug, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct Params {
    /// One of this many frames is held out; 2 or more.
    #[schemars(range(min = 2))]
    pub every: usize,
    /// One of this many frames is kept, from the first one on, and all between two kept ones are held out;
    /// frames after the last kept one are in neither part. Absent = `every` decides.
    #[schemars(range(min = 2))]
    pub keep_every: Option<usize>,
    /// Index of the first frame to hold out, counted from 0. Default: half of `every`, rounded down.
    pub first: Option<usize>,
}

impl Default for Params {
    fn default() -> Params {
        Params { every: 5, keep_every: None, first: None }
    }
}

photocurrent_core::ports! {
    /// What is split.
    pub struct In {
        /// Frames, captured or rendered; at least three.
        frames: FrameSequence,
    }
}

photocurrent_core::ports! {
    /// The two parts.
    pub struct Out {
        /// The frames to solve with.
        kept: FrameSequence,
        /// The frames to test on.
        held: FrameSequence,
    }
}

/// The node.
pub struct SplitFrames {
    params: Params,
}

impl SplitFrames {
    /// Indices of the frames to keep and to hold out.
    fn split(&self, count: usize) -> Result<(Vec<usize>, Vec<usize>), NodeError> {
        let Params { every, keep_every, first } = self.params;
        let first = first.unwrap_or(every / 2);
        if count < 3 {
            return Err(NodeError::usage(format!(
                "split/frames needs at least 3 frames, and there are {count}"
            ))
            .note("the first and the last frame are never held out")
            .hint("solve with all frames and leave the held-out score away"));
        }
        if let Some(n) = keep_every {
            let last = (count - 1) / n * n;
            if last == 0 {
                return Err(NodeError::usage(format!(
                    "`keep_every = {n}` keeps only the first of {count} frames"
                ))
                .note("what lies between two kept frames is held out")
                .hint(format!("keep one of {} or more", count - 1))
                .param("keep_every"));
            }
            return Ok((0..=last).partition(|l| l.is_multiple_of(n)));
        }
        let is_held =
            |l: &usize| *l >= first && (l - first).is_multiple_of(every) && *l > 0 && *l < count - 1;
        let (held, kept): (Vec<usize>, Vec<usize>) = (0..count).partition(is_held);
        if held.is_empty() {
            return Err(NodeError::usage(format!(
                "no frame of {count} is held out with `every = {every}` and `first = {first}`"
            ))
            .note("the first and the last frame are never held out")
            .hint(format!("choose `first` between 1 and {}", count - 2))
            .param("first"));
        }
        Ok((kept, held))
    }
}

impl Node for SplitFrames {
    const DECL: Decl = Decl {
        kind: "split/frames",
        about: "Holds every n-th frame out, to test a solution on frames it never saw.",
        revision: 2,
        grain: Grain::Pixel,
        draws: false,
        exports: false,
        sources: &["leave-one-out prediction"],
        example: r#"
[nodes.recording]
kind   = "read/recording"
params = { path = "scene.h5" }

[nodes.split]
kind   = "split/frames"
in     = { frames = "recording.frames" }
params = { every = 5 }
"#,
    };
    type Params = Params;
    type In = In;
    type Out = Out;

    fn build(params: Params) -> Result<Self, NodeError> {
        if params.every < 2 {
            return Err(NodeError::usage(format!(
                "`every` is {}, and must be 2 or more: otherwise nothing is kept",
                params.every
            ))
            .param("every"));
        }
        if params.keep_every.is_some_and(|n| n < 2) {
            return Err(NodeError::usage("`keep_every` must be 2 or more: otherwise nothing is held out")
                .param("keep_every"));
        }
        if params.keep_every.is_some() && params.first.is_some() {
            return Err(NodeError::usage("`first` belongs to `every`, and `keep_every` is stated")
                .hint("state one of the two")
                .param("first"));
        }
        Ok(SplitFrames { params })
    }

    fn plan(&self, inputs: &PortMetas) -> Result<Vec<Meta>, NodeError> {
        let frames = inputs.frames("frames")?;
        let (kept, held) = self.split(frames.times.len())?;
        let part = |indices: &[usize]| {
            Meta::Frames(Arc::new(FramesMeta { times: frames.times.select(indices), ..(**frames).clone() }))
        };
        Ok(vec![part(&kept), part(&held)])
    }

    fn run(&self, input: In, _: &Context) -> Result<Out, NodeError> {
        let (kept, held) = self.split(input.frames.len())?;
        Ok(Out { kept: input.frames.select(kept), held: input.frames.select(held) })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use photocurrent_core::testing;
    use std::collections::BTreeMap;

    fn split(
        count: usize,
        every: usize,
        first: Option<usize>,
    ) -> Result<(Vec<usize>, Vec<usize>), NodeError> {
        SplitFrames::build(Params { every, first, ..Params::default() })?.split(count)
    }

    #[test]
    fn one_of_n_is_kept_and_what_lies_between_is_held() {
        let split = |count: usize, n: usize| {
            SplitFrames::build(Params { keep_every: Some(n), ..Params::default() })?.split(count)
        };
        assert_eq!(split(10, 4).unwrap(), (vec![0, 4, 8], vec![1, 2, 3, 5, 6, 7]));
        assert_eq!(split(9, 2).unwrap().0, [0, 2, 4, 6, 8]);
        let error = split(4, 4).unwrap_err();
        assert_eq!(error.message, "`keep_every = 4` keeps only the first of 4 frames");
        assert_eq!(
            (error.hint.as_deref(), error.param.as_deref()),
            (Some("keep one of 3 or more"), Some("keep_every"))
        );
        assert!(split(9, 1).is_err());
        let both = Params { keep_every: Some(3), first: Some(1), ..Params::default() };
        assert_eq!(SplitFrames::build(both).err().unwrap().param.as_deref(), Some("first"));
    }

    #[test]
    fn every_fifth_frame_is_held_beginning_in_the_middle_of_the_first_five() {
        let (kept, held) = split(12, 5, None).unwrap();
        assert_eq!(held, [2, 7]);
        assert_eq!(kept, [0, 1, 3, 4, 5, 6, 8, 9, 10, 11]);
    }

    #[test]
    fn the_first_and_the_last_frame_are_never_held() {
        assert_eq!(split(5, 2, Some(0)).unwrap(), (vec![0, 1, 3, 4], vec![2]));
        assert_eq!(split(3, 2, None).unwrap(), (vec![0, 2], vec![1]));
    }

    #[test]
    fn a_split_that_holds_nothing_is_refused() {
        assert!(split(2, 2, None).unwrap_err().message.contains("at least 3 frames, and there are 2"));
        let error = split(4, 5, Some(3)).unwrap_err();
        assert_eq!(
            (error.param.as_deref(), error.hint.as_deref()),
            (Some("first"), Some("choose `first` between 1 and 2"))
        );
        assert_eq!(
            SplitFrames::build(Params { every: 1, ..Params::default() }).err().unwrap().param.as_deref(),
            Some("every")
        );
    }

    #[test]
    fn both_parts_keep_pictures_and_times_together_and_the_plan_says_so() {
        let frames = testing::frames(3, 2, 7);
        let node = SplitFrames::build(Params { every: 3, ..Params::default() }).unwrap();
        let metas =
            PortMetas::new(BTreeMap::from([("frames".to_string(), vec![Meta::Frames(frames.meta.clone())])]));
        let plan = node.plan(&metas).unwrap();
        let (out, _) = testing::with_context(frames.rows(), &["kept", "held"], |cx| {
            node.run(In { frames: frames.clone() }, cx)
        });
        let out = out.unwrap();
        assert_eq!(plan, [Meta::Frames(out.kept.meta.clone()), Meta::Frames(out.held.meta.clone())]);
        // Frames 1 and 4 of seven are held.
        assert_eq!(out.held.meta.times.exposures[1], frames.meta.times.exposures[4]);
        assert_eq!(
            out.held.read(1..2, frames.rows()).unwrap().dn,
            frames.read(4..5, frames.rows()).unwrap().dn
        );
        assert_eq!(out.kept.len(), 5);
    }
}
