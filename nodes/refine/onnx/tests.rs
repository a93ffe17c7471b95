//! Claims about the node, with the trained networks of `data/weights`.

use super::*;
use photocurrent_core::events::{Event, Polarity};
use photocurrent_core::{Colour, Exposure, Extent, FrameScale, FrameTimes, testing};
use std::path::PathBuf;

const EXTENT: Extent = Extent { width: 75, height: 50 };

fn data(name: &str) -> PathBuf {
    std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("../data").join(name)
}

fn params() -> Params {
    Params { weights: InputPath::new(data("weights/refine.onnx")), white: Some(200.0), ..Params::default() }
}

/// A checked ground with noise, by whole numbers.
fn dn(x: u32, y: u32) -> f32 {
    let noise = ((x * 7919 + y * 104_729) % 97) as f32 / 97.0;
    20.0 + 60.0 * ((x / 9 + y / 9) % 2) as f32 + 12.0 * noise
}

/// One frame of 4 ms around 10 ms.
fn frames_of(extent: Extent, dn: impl Fn(u32, u32) -> f32) -> FrameSequence {
    testing::captured(extent, vec![Exposure::new(8_000_000, 12_000_000)], 0, |_, x, y| dn(x, y))
}

fn frames() -> FrameSequence {
    frames_of(EXTENT, dn)
}

fn event(x: u16, y: u16) -> Event {
    Event { x, y, polarity: Polarity::On, t: 10_000_000, t_in: None }
}

fn frames_only(frames: FrameSequence) -> In {
    In { frames, sigma: None, events: None, alignment: None, captured: None, sensor: None }
}

fn run(params: Params, input: In) -> Result<(Vec<f32>, Vec<String>), NodeError> {
    let node = RefineOnnx::build(params)?;
    let rows = input.frames.rows();
    let (out, notes) = testing::with_context(rows, &["frames"], |cx| node.run(input, cx));
    let frames = out?.frames;
    Ok((frames.read_rows(frames.rows())?.dn, notes))
}

fn refined(input: In) -> Vec<f32> {
    run(params(), input).unwrap().0
}

fn largest_difference(a: &[f32], b: &[f32]) -> f32 {
    assert_eq!(a.len(), b.len());
    a.iter().zip(b).fold(0.0, |most, (a, b)| f32::max(most, (a - b).abs()))
}

/// `NAME.check.f32` was written by the training framework: a network's inputs of 32 x 48 values in their
/// order (one number where there are no channels) and what it gives for them. The interpolator is trained
/// with the refinement and run by `baseline/onnx`.
#[test]
fn networks_give_what_the_training_framework_gave() {
    let refine: &[(&str, usize)] = &[("frame", 1), ("sigma", 1), ("events", 2), ("captured", 1)];
    let interpolator: &[(&str, usize)] = &[
        ("before", 1),
        ("after", 1),
        ("voxel_before", 5),
        ("voxel_after", 5),
        ("voxel_exposures", 16),
        ("weight", 0),
    ];
    let networks = [
        ("refine", refine, OUTPUT),
        ("refine_alignment", refine, OUTPUT),
        ("refine_no_cbam", refine, OUTPUT),
        ("refine_no_perceptual", refine, OUTPUT),
        ("interpolator", interpolator, "picture"),
    ];
    for (name, inputs, output) in networks {
        let bytes = std::fs::read(data(&format!("weights/{name}.check.f32"))).unwrap();
        let numbers: Vec<f32> =
            bytes.chunks_exact(4).map(|four| f32::from_le_bytes(four.try_into().unwrap())).collect();
        let mut left = numbers.as_slice();
        let mut take = |channels: usize| {
            let shape = if channels > 0 { vec![1, channels, 32, 48] } else { vec![1; 4] };
            let (values, rest) = left.split_at(shape.iter().product());
            left = rest;
            Tensor { shape, values: values.to_vec() }
        };
        let given: Vec<(&str, Tensor)> =
            inputs.iter().map(|&(input, channels)| (input, take(channels))).collect();
        let expected = take(1);
        assert!(left.is_empty(), "{name}: {} numbers too many", left.len());
        let given: Vec<(&str, &Tensor)> = given.iter().map(|(input, tensor)| (*input, tensor)).collect();
        let content = std::fs::read(data(&format!("weights/{name}.onnx"))).unwrap();
        let found = crate::onnx::load(name, content, None).unwrap().run(&given, output).unwrap();
        let off = largest_difference(&found.values, &expected.values);
        assert!(off < 1e-5, "{name}: {off}");
        assert!(largest_difference(&found.values, &given[0].1.values) > 1e-3, "{name} changes something");
    }
}

#[test]
fn what_is_far_from_every_event_keeps_its_bits() {
    let (before, events) = (frames(), testing::stream(EXTENT, vec![event(40, 20)]));
    let stated = before.read_rows(before.rows()).unwrap().dn;
    let after = run(Params { quiet: true, ..params() }, In { events: Some(events), ..frames_only(before) })
        .unwrap()
        .0;
    let mut changed = 0;
    for (at, (before, after)) in stated.iter().zip(&after).enumerate() {
        let (x, y) = ((at % 75) as i32, (at / 75) as i32);
        if (x - 40).abs() > 5 || (y - 20).abs() > 5 {
            assert_eq!(before.to_bits(), after.to_bits(), "({x}, {y})");
        } else {
            changed += u32::from(before.to_bits() != after.to_bits());
        }
    }
    assert!(changed > 60, "{changed} of the 121 pixels near the event");
}

#[test]
fn pixels_that_never_fire_keep_their_bits() {
    let (before, events) = (frames(), testing::stream(EXTENT, vec![event(40, 20), event(43, 20)]));
    let stated = before.read_rows(before.rows()).unwrap().dn;
    let after = refined(In { events: Some(events), ..frames_only(before) });
    let changed: Vec<usize> =
        (0..stated.len()).filter(|&at| stated[at].to_bits() != after[at].to_bits()).collect();
    assert_eq!(changed, [20 * 75 + 40, 20 * 75 + 43]);
}

/// An array with every second pixel of the frames: an event of its pixel (20, 10) is at (40, 20), and the
/// frames' pixels between see half of it.
#[test]
fn events_of_another_array_are_where_its_pixels_lie() {
    let array = Extent { width: 38, height: 25 };
    let place = |at: usize| ((at % 38) as f32 * 2.0, (at / 38) as f32 * 2.0);
    let alignment = || {
        let places: Vec<(f32, f32)> = (0..array.pixels()).map(place).collect();
        let (x, y) = places.into_iter().unzip();
        Alignment { events: array, x, y }.into_map()
    };
    let seen = |x, y| In {
        events: Some(testing::stream(array, vec![event(x, y)])),
        alignment: Some(alignment()),
        ..frames_only(frames())
    };
    let rule = StepRule { threshold_on: 1.0, threshold_off: 1.0, stamp: Stamp::OffPixel, shift_ns: 0 };
    let counts = EventCounts::from_input(&seen(20, 10), &rule).unwrap();
    let (near, silent) = (counts.counts_near(10_000_000, 1_000_000), counts.without_events());
    for (at, (near, silent)) in near.iter().zip(&silent).enumerate() {
        let (x, y) = ((at % 75) as f32, (at / 75) as f32);
        let expected =
            f32::max(1.0 - (x - 40.0).abs() / 2.0, 0.0) * f32::max(1.0 - (y - 20.0).abs() / 2.0, 0.0);
        assert!((near - expected).abs() < 1e-3, "({x}, {y}): {near}, not {expected}");
        assert_eq!(*silent, expected < 1e-3, "({x}, {y})");
    }
    assert!(near[75 * 50..].iter().all(|off| *off == 0.0), "there was no OFF event");
    let stated = frames().read_rows(EXTENT.rows()).unwrap().dn;
    let after = refined(seen(20, 10));
    let changed = (0..stated.len()).filter(|&at| stated[at].to_bits() != after[at].to_bits());
    assert!(changed.clone().all(|at| !silent[at]) && changed.count() > 4);
    let without = run(params(), In { alignment: None, ..seen(20, 10) }).err().unwrap();
    assert_eq!(without.message, "the events are of 38 x 25 pixels, and the frames of 75 x 50");
}

#[test]
fn values_change_by_their_standard_deviations_at_most() {
    let stated = frames().read_rows(EXTENT.rows()).unwrap().dn;
    // Pixels of unlike standard deviations; what is not known sets no limit.
    let sigma = |x: u32, _: u32| [0.0, 0.5, 2.0, f32::NAN][x as usize % 4];
    let with = |most_sigmas| {
        run(
            Params { most_sigmas, ..params() },
            In { sigma: Some(frames_of(EXTENT, sigma)), ..frames_only(frames()) },
        )
        .unwrap()
        .0
    };
    let free = with(f64::INFINITY);
    for most in [1.0, 3.0] {
        for (at, (&after, &free)) in with(most).iter().zip(&free).enumerate() {
            let (stated, sigma) = (f64::from(stated[at]), f64::from(sigma(at as u32 % 75, 0)));
            let limit = if sigma.is_nan() { f64::INFINITY } else { most * sigma };
            let expected = f64::from(free).clamp(stated - limit, stated + limit);
            assert!((f64::from(after) - expected).abs() < 1e-5, "{after} instead of {expected}");
        }
    }
    assert!(largest_difference(&free, &with(1.0)) > 2.0, "the limit is felt");
}

#[test]
fn events_beyond_the_window_are_none() {
    let input = || In {
        events: Some(testing::stream(EXTENT, vec![event(40, 20)])),
        ..frames_only(frames_of(EXTENT, dn))
    };
    let late = |ns: i64| {
        testing::captured(EXTENT, vec![Exposure::new(8_000_000 + ns, 12_000_000 + ns)], 0, |_, x, y| dn(x, y))
    };
    let stated = input().frames.read_rows(EXTENT.rows()).unwrap().dn;
    let with = |window: Option<i64>, ns| {
        run(Params { window: window.map(Duration::new), ..params() }, In { frames: late(ns), ..input() })
            .unwrap()
            .0
    };
    assert!(largest_difference(&with(None, 9_000_000), &stated) > 0.0);
    assert_eq!(with(None, 10_000_000), stated);
    assert_eq!(with(Some(3_000_000), 9_000_000), stated);
}

#[test]
fn tiles_show_no_seams() {
    // Two tiles along each side against one; what is left is what the surroundings do not reach.
    let extent = Extent { width: 200, height: 170 };
    let with = |tile, overlap| {
        run(Params { tile, overlap, ..params() }, frames_only(frames_of(extent, dn))).unwrap().0
    };
    let whole = with(256, 64);
    let off = largest_difference(&with(112, 64), &whole);
    assert!(off < 0.02, "{off} DN of 200 between tiles and the whole");
    // The test can fail: without surroundings there are seams.
    let seams = largest_difference(&with(112, 0), &whole);
    assert!(seams > 10.0 * off.max(0.02), "{seams} DN without surroundings");
}

#[test]
fn colours_are_refined_one_after_the_other() {
    let colour = |x: u32, y: u32, c: u32| dn(x + 3 * c, y) * (1.0 + 0.2 * c as f32);
    let meta = FramesMeta {
        extent: EXTENT,
        colour: Colour::Rgb,
        times: FrameTimes::new(vec![Exposure::new(8_000_000, 12_000_000)], 0).unwrap(),
        scale: FrameScale::Captured,
    };
    let mut block = FrameBlock::zeros(0..1, EXTENT.rows(), meta.row_values());
    block.dn.iter_mut().enumerate().for_each(|(at, value)| {
        *value = colour((at as u32 / 3) % EXTENT.width, at as u32 / 3 / EXTENT.width, at as u32 % 3)
    });
    let together = refined(frames_only(FrameSequence::in_memory(Arc::new(meta), block)));
    for c in 0..3 {
        let alone = refined(frames_only(frames_of(EXTENT, |x, y| colour(x, y, c))));
        let of_colour: Vec<f32> = together.iter().skip(c as usize).step_by(3).copied().collect();
        assert_eq!(of_colour, alone);
    }
}

#[test]
fn a_captured_frame_of_twice_the_exposure_counts_as_half_as_bright() {
    let captured = |ns: i64, factor: f32| {
        testing::captured(EXTENT, vec![Exposure::new(10_000_000 - ns, 10_000_000 + ns)], 0, |_, x, y| {
            factor * dn(y, x)
        })
    };
    let with = |captured| refined(In { captured: Some(captured), ..frames_only(frames()) });
    let once = with(captured(2_000_000, 1.0));
    assert!(largest_difference(&once, &with(captured(4_000_000, 2.0))) < 1e-3);
    assert!(
        largest_difference(&once, &with(captured(2_000_000, 2.0))) > 0.1,
        "the captured frame has an effect"
    );
    assert!(largest_difference(&once, &refined(frames_only(frames()))) > 0.1);
}

#[test]
fn the_standard_deviation_has_a_say() {
    let unlimited = || Params { most_sigmas: f64::INFINITY, ..params() };
    let with = |sigma: f32| {
        run(unlimited(), In { sigma: Some(frames_of(EXTENT, move |_, _| sigma)), ..frames_only(frames()) })
            .unwrap()
            .0
    };
    assert!(largest_difference(&with(2.0), &with(20.0)) > 0.1);
    assert_eq!(with(f32::NAN), with(0.0));
}

#[test]
fn unknown_values_stay_unknown_and_are_counted() {
    let input = frames_only(frames_of(EXTENT, |x, y| if (x, y) == (3, 4) { f32::NAN } else { dn(x, y) }));
    let (after, notes) = run(params(), input).unwrap();
    assert_eq!(
        after.iter().enumerate().filter(|(_, dn)| dn.is_nan()).map(|(at, _)| at).collect::<Vec<_>>(),
        [4 * 75 + 3]
    );
    assert_eq!(notes, ["1 values are not known (NaN) and stay so; the network sees black there"]);
}

#[test]
fn white_is_measured_where_it_is_not_stated() {
    // 1,000 values 1, 2 ... 1000: white lies above 999 of them.
    let extent = Extent { width: 40, height: 25 };
    let (_, notes) = run(
        Params { white: None, ..params() },
        frames_only(frames_of(extent, |x, y| (40 * y + x + 1) as f32)),
    )
    .unwrap();
    assert_eq!(notes, ["white is 1000.0 DN, below which 99.9 % of the values lie"]);
    let error =
        run(Params { white: None, ..params() }, frames_only(frames_of(extent, |_, _| 0.0))).err().unwrap();
    assert_eq!(
        (error.message.as_str(), error.param.as_deref()),
        ("white, 0 DN, is not above black, 0 DN", Some("white"))
    );
}

#[test]
fn one_pixel_and_no_frame_at_all_come_through() {
    let one = Extent { width: 1, height: 1 };
    assert!(refined(frames_only(frames_of(one, |_, _| 40.0)))[0].is_finite());
    let none = testing::captured(one, Vec::new(), 0, |_, _, _| 0.0);
    assert_eq!(run(Params { white: None, ..params() }, frames_only(none)).unwrap(), (Vec::new(), Vec::new()));
}

#[test]
fn what_does_not_fit_is_refused_with_what_to_do() {
    let refused = |params: Params, input: In| run(params, input).err().unwrap();
    assert_eq!(RefineOnnx::build(Params::default()).err().unwrap().param.as_deref(), Some("weights"));
    let error = RefineOnnx::build(Params { tile: 100, ..params() }).err().unwrap();
    assert_eq!(
        (error.message.as_str(), error.hint.as_deref()),
        ("`tile` is 100, which is no multiple of 16", Some("set `tile = 112`"))
    );
    let error =
        refused(Params { weights: InputPath::new("no/such.onnx"), ..params() }, frames_only(frames()));
    assert_eq!(error.message, "cannot read no/such.onnx: there is no such file");
    let error = refused(
        Params { weights: InputPath::new(data("networks/blend.onnx")), ..params() },
        frames_only(frames()),
    );
    assert!(
        error.message.starts_with("blend.onnx takes ") && error.param.as_deref() == Some("weights"),
        "{}",
        error.message
    );
    let other = Extent { width: 70, height: 50 };
    let error = refused(params(), In { sigma: Some(frames_of(other, dn)), ..frames_only(frames()) });
    assert!(error.message.starts_with("`sigma` has 1 frames of 70 x 50 pixels"), "{}", error.message);
    let error = refused(
        params(),
        In { events: Some(testing::stream(other, vec![event(1, 1)])), ..frames_only(frames()) },
    );
    assert_eq!(error.message, "the events are of 70 x 50 pixels, and the frames of 75 x 50");
    let error = refused(params(), In { captured: Some(frames_of(other, dn)), ..frames_only(frames()) });
    assert!(error.message.starts_with("the captured frames are of 70 x 50 pixels"), "{}", error.message);
    let mosaic = frames();
    let meta = FramesMeta {
        colour: Colour::Bayer(photocurrent_core::colour::Order::Rggb),
        ..(*mosaic.meta).clone()
    };
    let block = mosaic.read_rows(mosaic.rows()).unwrap();
    let error = refused(params(), frames_only(FrameSequence::in_memory(Arc::new(meta), block)));
    assert!(error.hint.unwrap().contains("render/demosaic"));
}

#[test]
fn the_files_that_matter_enter_the_key() {
    let node =
        RefineOnnx::build(Params { runtime: Some(InputPath::new("libonnxruntime.so")), ..params() }).unwrap();
    assert_eq!(
        node.files().iter().map(|file| file.param.as_str()).collect::<Vec<_>>(),
        ["weights", "runtime"]
    );
}
