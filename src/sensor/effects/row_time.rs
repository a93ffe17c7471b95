//! Row time: the rows of a frame are not exposed at the pace that the recording states.
//!
//! With a rolling shutter row `r` starts `r` row times after row 0. When the real row time differs, every row
//! is exposed earlier or later than the recording says, the more so the further down. Moving objects lean
//! more or less than expected. Typical error: 0.1 to 5 us, or the whole row time when a rolling shutter is
//! taken for a global one.
//!
//! Parameter: `row_time`, the real one; negative = rows are read from the last to the first; its null is the
//! recording's own. A clock offset misplaces all rows alike.
//!
//! Source: the paper, Section 4.1 (rolling shutter).
//! Limits: linear in the row.

use super::sought::{Field, Measure, Search, Size, Sought};
use super::{Effect, EffectDecl, EffectKind, ParameterDecl, Parameters, RowSite, Stage, Unit};
use photocurrent_core::Exposure;

/// The catalogue entry.
pub(super) const KIND: EffectKind = EffectKind {
    decl: EffectDecl {
        id: "row_time",
        stage: Stage::Exposure,
        about: "Rows are exposed at another pace than stated",
        equation: "t_start(row r) = t_start(row 0) + r * row_time",
        parameters: &[ParameterDecl {
            name: "row_time",
            unit: Unit::Time,
            null: None,
            allowed: (-1.0, 1.0),
            plausible: (0.0, 1e-4),
            about: "real delay from one row to the next; 0 = global shutter, negative = from the last row \
                    to the first",
        }],
        covariate: "row*slope",
        signature: "frames differ from what events predict in proportion to row times rate of change",
        confused_with: &["clock_offset", "row_skew", "misalignment"],
        source: "the paper, Section 4.1",
        apart: &[],
        search: Search::For(&[Sought {
            typical: Size::Larger(&Size::Of(0.5, Measure::RowTime), &Size::Fixed(5e-6)),
            material: Size::Over(&Size::Fixed(2e-6), Measure::Rows),
            field: Some(Field::RowTime),
            ..Sought::both("row_time")
        }]),
    },
    build,
};

fn build(parameters: &Parameters) -> Result<Box<dyn Effect>, String> {
    Ok(Box::new(RowTime { row_time_ns: parameters.need_ns("row_time")? }))
}

/// A real row time that differs from the stated one.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct RowTime {
    /// Real delay from one row to the next, nanoseconds.
    pub row_time_ns: i64,
}

impl Effect for RowTime {
    fn id(&self) -> &'static str {
        KIND.decl.id
    }

    fn exposure(&self, row: &RowSite, exposure: Exposure) -> Exposure {
        exposure.delayed(i64::from(row.y) * (self.row_time_ns - row.row_time_ns))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn exposed(row_time_ns: i64, y: u32) -> Exposure {
        let stated = Exposure::new(0, 4_000_000).delayed(30_000 * i64::from(y));
        RowTime { row_time_ns }.exposure(&RowSite { y, height: 100, frame: 2, row_time_ns: 30_000 }, stated)
    }

    #[test]
    fn row_r_moves_by_r_times_the_difference_and_keeps_its_length() {
        for y in [0, 1, 99] {
            let start = 31_000 * i64::from(y);
            assert_eq!(exposed(31_000, y), Exposure::new(start, start + 4_000_000));
            assert_eq!(exposed(0, y), Exposure::new(0, 4_000_000));
            assert_eq!(exposed(-30_000, y), Exposure::new(0, 4_000_000).delayed(-30_000 * i64::from(y)));
        }
    }
}
