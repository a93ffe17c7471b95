//! `compensate/readout`: what each pixel missed while it was read out and at rest, added to its steps.
//!
//! Between an event's in-pixel time and the end of the refractory period the front-end voltage moves unseen,
//! so two events lie further apart than one threshold. Eqs. (9) to (12) estimate the missed part from the
//! slope of the next interval; this node stores the result as the event column `step`, for methods that have
//! no latch of their own (double integrals, filters). `solve/map` does the same inside with
//! `readout = "slope"` and refuses a stream that was compensated before.
//!
//! Limits: those of [`photocurrent_sensor::readout`]: close ON/OFF pairs break the assumption of one slope.
//! Needs in-pixel times.

use photocurrent_core::events::Polarity;
use photocurrent_core::{
    Context, Decl, EventStream, EventsMeta, Grain, Meta, Node, NodeError, PortMetas, Sensor,
};
use photocurrent_sensor::readout::compensated_step;
use photocurrent_solve::pixel_events::{Stamp, StepRule, check_events, clock_offset};
use rayon::prelude::*;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::sync::Arc;

/// Parameters of `compensate/readout`: there are none, the sensor description says all.
#[derive(Clone, Debug, Default, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct Params {}

photocurrent_core::ports! {
    /// Inputs.
    pub struct In {
        /// Events with both stamps.
        events: EventStream,
        /// Thresholds and refractory period.
        sensor: Arc<Sensor>,
    }
}

photocurrent_core::ports! {
    /// Outputs.
    pub struct Out {
        /// The same events with the column `step`.
        events: EventStream,
    }
}

/// The node.
pub struct CompensateReadout;

const LEAVE_OUT: &str = "leave this node out, and connect the events themselves to what follows";

impl Node for CompensateReadout {
    const DECL: Decl = Decl {
        kind: "compensate/readout",
        about: "Adds to each event's step what its pixel missed during readout latency and refractory \
                period.",
        revision: 1,
        grain: Grain::Pixel,
        draws: false,
        exports: false,
        sources: &["Jiang et al., CVPR 2024, Eqs. (9)-(12)"],
        example: r#"
[nodes.compensate]
kind = "compensate/readout"
in   = { events = "recording.events", sensor = "sensor" }
"#,
    };
    const LOCAL_IN_TIME: bool = true;
    type Params = Params;
    type In = In;
    type Out = Out;

    fn build(_: Params) -> Result<Self, NodeError> {
        Ok(CompensateReadout)
    }

    fn plan(&self, inputs: &PortMetas) -> Result<Vec<Meta>, NodeError> {
        let (events, sensor) = (inputs.events("events")?, inputs.sensor("sensor")?);
        check_events(events, "compensate/readout", LEAVE_OUT)?;
        let refractory = ("readout.refractory", sensor.readout.refractory.is_some());
        sensor
            .need_all(&[StepRule::needs(sensor).as_slice(), &[refractory]].concat(), "compensate/readout")?;
        StepRule::from_sensor(sensor, events, Stamp::Best, "compensate/readout")?;
        Ok(vec![Meta::Events(Arc::new(EventsMeta { has_step: true, ..(**events).clone() }))])
    }

    fn run(&self, input: In, cx: &Context) -> Result<Out, NodeError> {
        let (events, sensor) = (&input.events, &*input.sensor);
        check_events(&events.meta, "compensate/readout", LEAVE_OUT)?;
        let rule = StepRule::from_sensor(sensor, &events.meta, Stamp::Best, "compensate/readout")?;
        let refractory_s =
            sensor.need(sensor.readout.refractory, "readout.refractory", "compensate/readout")?.seconds();
        clock_offset(sensor)?;
        cx.begin(cx.rows().len() as u64, "rows");
        let mut band = events.read(cx.rows())?;
        let width = events.meta.extent.width;
        let compensate_row = |row: u32| -> Result<Vec<f32>, NodeError> {
            let row = band.row(row);
            let index = row.by_pixel(width);
            let mut steps = vec![0.0; row.len()];
            for x in 0..width as usize {
                let mut before: Option<usize> = None;
                for &k in index.pixel(x) {
                    let plain = rule.plain_step(Polarity::from_bit(row.on[k]));
                    let step = before.map_or(plain, |before| {
                        // Only differences count, so seconds since the event before lose nothing.
                        let since = |t: i64| (t - rule.time(&row, before)) as f64 * 1e-9;
                        compensated_step(
                            plain,
                            0.0,
                            since(row.t[before] - rule.shift_ns),
                            since(rule.time(&row, k)),
                            refractory_s,
                        )
                    });
                    steps[k] = step as f32;
                    before = Some(k);
                }
            }
            cx.advance(1)?;
            Ok(steps)
        };
        let steps: Result<Vec<Vec<f32>>, NodeError> =
            cx.rows().iter().into_par_iter().map(compensate_row).collect();
        band.step = Some(steps?.concat());
        let meta = EventsMeta { has_step: true, ..(*events.meta).clone() };
        Ok(Out { events: EventStream::in_memory(Arc::new(meta), band) })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use photocurrent_core::events::Event;
    use photocurrent_core::quantity::Duration;
    use photocurrent_core::{Extent, testing};

    fn sensor() -> Sensor {
        let mut sensor = Sensor::unknown("test");
        sensor.comparator.threshold_on = Some(0.2);
        sensor.comparator.threshold_off = Some(0.3);
        sensor.readout.refractory = Some(Duration::new(60_000));
        sensor
    }

    #[test]
    fn half_a_threshold_missed_is_half_a_threshold_added() {
        // 40 us latency and 60 us rest, then 200 us armed: 0.2 x (1 + 100 / 200).
        let event = |t_in: i64, polarity| Event { x: 1, y: 0, polarity, t: t_in + 40_000, t_in: Some(t_in) };
        let events = testing::stream(
            Extent { width: 2, height: 1 },
            vec![event(1_000_000, Polarity::Off), event(1_300_000, Polarity::On)],
        );
        let (out, _) = testing::with_context(events.rows(), &["events"], |cx| {
            CompensateReadout.run(In { events: events.clone(), sensor: Arc::new(sensor()) }, cx)
        });
        let band = out.unwrap().events.read(events.rows()).unwrap();
        assert_eq!(band.step.as_deref(), Some(&[-0.3_f32, 0.3][..]));
    }

    #[test]
    fn off_pixel_times_alone_are_refused_with_the_reason() {
        let event = Event { x: 0, y: 0, polarity: Polarity::On, t: 5, t_in: None };
        let events = testing::stream(Extent { width: 1, height: 1 }, vec![event]);
        assert_eq!(
            check_events(&events.meta, "compensate/readout", LEAVE_OUT).unwrap_err().message,
            "compensate/readout needs in-pixel times, and `events` has only off-pixel times"
        );
    }
}
