//! One interval of the linearised problem: what its unknown is, and derivatives by it.

/// What the unknown of a knot is.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) enum Chart {
    /// `d_k`; at the first knot the level `V(1)`.
    #[default]
    Step,
    /// `u_k`, near a fold.
    LogPhotocurrent,
    /// None: the frames push the knot beyond its fold, so it stays there and follows the voltage before it.
    Fold,
}

/// First derivatives of one interval, and second ones of its EVS row. `s` is the knot's unknown, `V` the
/// voltage before.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Stage {
    /// What `s` is.
    pub chart: Chart,
    /// Step by `s`.
    pub step_s: f64,
    /// Step by `V`.
    pub step_v: f64,
    /// Log photocurrent by `s`.
    pub u_s: f64,
    /// Log photocurrent by `V`.
    pub u_v: f64,
    /// Log photocurrent by the one before it.
    pub u_before: f64,
    /// Step by `s` twice; kept at folds only, where it is all that is left.
    pub step_ss: f64,
    /// Step by `s` and `V`; kept at folds only.
    pub step_sv: f64,
    /// Half the second derivative of the weighted squared EVS row by `s`, positive.
    pub curvature_ss: f64,
    /// The same by `s` and `V`.
    pub curvature_sv: f64,
    /// The same by `V`, not negative.
    pub curvature_vv: f64,
    /// What damping adds to `curvature_ss`, per unit of damping; positive.
    pub damping: f64,
}

impl Stage {
    /// Both step and log photocurrent follow the voltage before: the step by the envelope theorem (its slope
    /// by the log photocurrent is zero), the log photocurrent such that this slope stays zero.
    pub(super) fn held_at_fold(&self) -> Stage {
        Stage {
            chart: Chart::Fold,
            step_s: 0.0,
            u_s: 0.0,
            u_v: -self.step_sv / self.step_ss,
            // The unknown is idle; any positive curvature keeps it at zero.
            curvature_ss: self.curvature_vv,
            curvature_sv: 0.0,
            ..*self
        }
    }
}
