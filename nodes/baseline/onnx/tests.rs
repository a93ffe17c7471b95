//! Claims about the node, by two networks whose pictures are known by algebra (`data/networks`): `blend`
//! gives `(1 - t) before + t after + (sum of the voxel grid) / 4`, `accumulate` gives
//! `1/2 + (all that it ever saw) / 8`.

use super::voxel::{Normalise, Signs, Stretch};
use super::*;
use layout::Window;
use photocurrent_core::events::{Event, Polarity};
use photocurrent_core::quantity::Rate;
use photocurrent_core::{Exposure, Extent, testing};

const EXTENT: Extent = Extent { width: 6, height: 4 };

fn network(name: &str) -> InputPath {
    InputPath::new(std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("../data/networks").join(name))
}

/// Two frames of 2 ms at 1 and at 9 ms, of 20 and 60 DN, brighter by 1 DN a column.
fn frames() -> FrameSequence {
    let exposures = vec![Exposure::new(0, 2_000_000), Exposure::new(8_000_000, 10_000_000)];
    testing::captured(EXTENT, exposures, 0, |l, x, _| [20.0, 60.0][l] + x as f32)
}

/// ON at (1, 2) after 2 and 4 ms, OFF at (5, 0) after 6 ms.
fn events() -> EventStream {
    let event = |x, y, polarity, t| Event { x, y, polarity, t, t_in: None };
    testing::stream(
        EXTENT,
        vec![
            event(1, 2, Polarity::On, 2_000_000),
            event(1, 2, Polarity::On, 4_000_000),
            event(5, 0, Polarity::Off, 6_000_000),
        ],
    )
}

fn blend() -> Params {
    let frame = |input: &str, take| FrameInput { input: input.into(), take, channels: 1, range: [0.0, 1.0] };
    Params {
        network: network("blend.onnx"),
        frames: vec![frame("before", Side::Before), frame("after", Side::After)],
        voxels: vec![voxel("voxel", 3, Window::BeforeToInstant, Signs::Signed)],
        time: Some("t".into()),
        output: "image".into(),
        white: Some(100.0),
        // One picture a millisecond, of the captured frames' own exposure: DN are percent of white.
        sampling: Sampling {
            rate: Rate::new(1000.0),
            exposure: Duration::new(2_000_000),
            ..Sampling::default()
        },
        ..Params::default()
    }
}

fn voxel(input: &str, bins: u32, window: Window, polarity: Signs) -> VoxelInput {
    VoxelInput {
        input: input.into(),
        bins,
        window,
        polarity,
        normalise: Normalise::Nothing,
        stretch: Stretch::Window,
        reversed: false,
    }
}

fn accumulate() -> Params {
    Params {
        network: network("accumulate.onnx"),
        frames: Vec::new(),
        voxels: vec![voxel("voxel", 1, Window::SinceLast, Signs::Separate)],
        time: None,
        states: vec![StateInput {
            input: "count".into(),
            output: "count_out".into(),
            channels: 1,
            downscale: 1,
        }],
        ..blend()
    }
}

fn run(params: Params) -> Result<(FrameSequence, Vec<String>), NodeError> {
    run_on(frames(), params)
}

fn run_on(frames: FrameSequence, params: Params) -> Result<(FrameSequence, Vec<String>), NodeError> {
    let node = BaselineOnnx::build(params)?;
    let input = In { frames, events: Some(events()), sensor: None, at: None };
    let (out, notes) = testing::with_context(EXTENT.rows(), &["frames"], |cx| node.run(input, cx));
    Ok((out?.frames, notes))
}

/// The picture whose exposure has its middle at `ms`.
fn at(frames: &FrameSequence, ms: i64) -> impl Fn(usize, u32) -> f32 {
    let n =
        frames.meta.times.exposures.iter().position(|exposure| exposure.mid().0 == ms * 1_000_000).unwrap();
    let block = frames.read(n..n + 1, frames.rows()).unwrap();
    move |x, y| block.row(n, y)[x]
}

/// A network that blends pictures of three channels.
fn blend_in_colour() -> Params {
    let frame = |input: &str, take| FrameInput { input: input.into(), take, channels: 3, range: [0.0, 1.0] };
    Params {
        network: network("stand_in_film.onnx"),
        frames: vec![frame("x0", Side::Before), frame("x1", Side::After)],
        voxels: Vec::new(),
        time: Some("time".into()),
        time_dimensions: 2,
        ..blend()
    }
}

/// Two frames in colour, of 20 and 60 DN; green is brighter by 2 DN and blue by 5, a column by 1 DN.
fn frames_in_colour() -> FrameSequence {
    let grey = frames();
    let meta = FramesMeta { colour: Colour::Rgb, ..(*grey.meta).clone() };
    let mut block = FrameBlock::zeros(0..2, meta.extent.rows(), meta.row_values());
    let width = meta.row_values();
    for (at, dn) in block.dn.iter_mut().enumerate() {
        let (x, channel) = (at % width / 3, at % 3);
        let frame = at / (width * EXTENT.height as usize);
        *dn = [20.0, 60.0][frame] + x as f32 + [0.0, 2.0, 5.0][channel];
    }
    FrameSequence::in_memory(Arc::new(meta), block)
}

#[test]
fn each_colour_of_frames_goes_through_a_network_of_three_channels() {
    let (blended, _) = run_on(frames_in_colour(), Params { multiple: 8, ..blend_in_colour() }).unwrap();
    assert_eq!(blended.meta.colour, Colour::Rgb);
    let value = at(&blended, 3);
    for (x, channel) in (0..6).flat_map(|x| (0..3).map(move |channel| (x, channel))) {
        let expected = 30.0 + x as f32 + [0.0, 2.0, 5.0][channel];
        let found = value(3 * x + channel, 2);
        assert!((found - expected).abs() < 1e-3, "column {x}, channel {channel}: {found}");
    }
}

#[test]
fn frames_in_colour_and_a_network_of_one_channel_are_refused() {
    let error = run_on(frames_in_colour(), blend()).err().unwrap();
    assert_eq!(error.param.as_deref(), Some("frames"));
    assert!(error.message.contains("frames are in colour"), "{}", error.message);
}

#[test]
fn halving_takes_the_nearest_of_the_pictures_between_the_frames() {
    // A network that blends: twice halved, pictures stand at quarters of the way from 20 to 60 DN, at 1, 3,
    // 5, 7 and 9 ms. Another time than 1/2 would give others.
    let halves = |halvings| Params { halvings, ..blend_in_colour() };
    let dn = |halvings, ms: i64| at(&run(halves(halvings)).unwrap().0, ms)(0, 0);
    for (ms, expected) in [(1, 20.0), (3, 30.0), (5, 40.0), (7, 50.0), (9, 60.0)] {
        assert!((dn(2, ms) - expected).abs() < 1e-4, "{ms} ms: {}", dn(2, ms));
    }
    // Thrice halved they stand a millisecond apart; once, only in the middle.
    assert!((dn(3, 4) - 35.0).abs() < 1e-4 && (dn(1, 4) - 40.0).abs() < 1e-4);
    let refused = |params: Params| BaselineOnnx::build(params).err().and_then(|error| error.param);
    assert_eq!(
        refused(Params { halvings: 2, ..blend() }).as_deref(),
        Some("halvings"),
        "events have no place in it"
    );
    assert_eq!(refused(Params { output_range: [0.0, 2.0], ..halves(2) }).as_deref(), Some("halvings"));
    assert_eq!(
        refused(Params { frames: halves(2).frames[..1].to_vec(), ..halves(2) }).as_deref(),
        Some("halvings")
    );
}

#[test]
fn a_window_may_hold_both_exposures_whole() {
    // Frames are exposed from 0 to 2 and from 8 to 10 ms.
    let moments = layout::moments(&frames().meta, &frames().meta);
    assert_eq!(Window::Exposures.of(&moments[0], None, None), 0..10_000_000);
    assert_eq!(Window::Between.of(&moments[0], None, None), 1_000_000..9_000_000);
}

#[test]
fn frames_events_and_instants_reach_their_inputs() {
    for multiple in [1, 8] {
        let (frames, notes) = run(Params { multiple, ..blend() }).unwrap();
        // At 3 ms: a quarter of the way; 20 + 40/4 DN, and one ON event, 25 % of white.
        let picture = at(&frames, 3);
        assert!((picture(0, 0) - 30.0).abs() < 1e-4 && (picture(4, 3) - 34.0).abs() < 1e-4);
        assert!((picture(1, 2) - (31.0 + 25.0)).abs() < 1e-4, "{}", picture(1, 2));
        // At 7 ms: three quarters; two ON events, one OFF.
        let picture = at(&frames, 7);
        assert!((picture(1, 2) - (51.0 + 50.0)).abs() < 1e-4 && (picture(5, 0) - (55.0 - 25.0)).abs() < 1e-4);
        // The recording lasts from 0 to 10 ms, the frames' middles lie at 1 and at 9.
        assert_eq!(frames.len(), 9);
        assert!(
            notes.contains(
                &"1 wanted instants do not lie between two captured frames, and are left out".into()
            ),
            "{notes:?}"
        );
        // At 1 ms the window is empty, and it ends before the event at 2 ms.
        assert!(notes.contains(&"2 pictures saw no event in `voxel`".into()), "{notes:?}");
    }
}

#[test]
fn what_a_network_remembers_goes_from_picture_to_picture() {
    let (frames, _) = run(accumulate()).unwrap();
    // Nothing hangs on frames: no instant is left out.
    assert_eq!(frames.len(), 10);
    // Windows end before their instant: the event at 2 ms is in the picture of 3 ms.
    let seen: Vec<f32> = (0..10).map(|ms| at(&frames, ms)(1, 2)).collect();
    assert_eq!(seen, [50.0, 50.0, 50.0, 62.5, 62.5, 75.0, 75.0, 75.0, 75.0, 75.0]);
    // Counted apart, OFF is no less than ON.
    assert_eq!((at(&frames, 6)(5, 0), at(&frames, 7)(5, 0)), (50.0, 62.5));
}

#[test]
fn ranges_and_encodings_are_undone() {
    let wide = |range| {
        let params = blend();
        let frames = params.frames.iter().map(|frame| FrameInput { range, ..frame.clone() }).collect();
        run(Params { frames, voxels: params.voxels.clone(), output_range: range, ..params }).unwrap().0
    };
    // Without an event the network is linear in its frames: whatever the range, the same light.
    assert!(
        (at(&wide([-1.0, 1.0]), 5)(3, 1) - 43.0).abs() < 1e-3
            && (at(&wide([0.0, 255.0]), 5)(3, 1) - 43.0).abs() < 1e-3
    );
    let (curved, _) = run(Params { encoding: Encoding::Srgb, ..blend() }).unwrap();
    // Halfway on the curve of IEC 61966-2-1 between 23 and 63 % of white: ((0.51688 + 0.81525) / 2 + 0.055) /
    // 1.055 to the power of 2.4.
    assert!((at(&curved, 5)(3, 1) - 40.1175).abs() < 1e-3, "{}", at(&curved, 5)(3, 1));
}

#[test]
fn a_layout_that_does_not_fit_the_network_is_reported_with_what_it_has() {
    let refused = |params: Params| run(params).err().unwrap();
    let error = refused(Params { time: Some("time".into()), ..blend() });
    assert_eq!(
        (error.message.as_str(), error.param.as_deref()),
        ("the network blend.onnx has no input `time`", Some("time"))
    );
    assert_eq!(error.notes, ["its inputs: `before`, `after`, `voxel`, `t`", "its outputs: `image`"]);
    let error = refused(Params { time: None, ..blend() });
    assert_eq!(error.message, "the network blend.onnx takes `t`, and nothing says what that is");
    let error = refused(Params { output: "picture".into(), ..blend() });
    assert_eq!(error.message, "the network blend.onnx has no output `picture`");
    let error = refused(Params { voxels: vec![voxel("t", 3, Window::Between, Signs::Signed)], ..blend() });
    assert_eq!(
        (error.message.as_str(), error.param.as_deref()),
        ("the input `t` stands in `voxels` and again in `time`", Some("time"))
    );
    // A grid of two bins for a network of three.
    let error =
        refused(Params { voxels: vec![voxel("voxel", 2, Window::Between, Signs::Signed)], ..blend() });
    assert!(error.message.contains("blend.onnx"), "{}", error.message);
    let lost = Params { network: InputPath::new("no/such.onnx"), ..blend() };
    assert_eq!(refused(lost).message, "cannot read no/such.onnx: there is no such file");
    let error = refused(Params {
        states: vec![StateInput { input: "s".into(), output: "s_out".into(), channels: 1, downscale: 8 }],
        multiple: 4,
        ..blend()
    });
    assert_eq!(error.param.as_deref(), Some("multiple"));
    let error = refused(Params { output_range: [1.0, 1.0], ..blend() });
    assert_eq!(error.param.as_deref(), Some("output_range"));
}

#[test]
fn instants_without_a_frame_on_either_side_and_missing_events_are_reported() {
    let node = BaselineOnnx::build(blend()).unwrap();
    let one = testing::captured(EXTENT, vec![Exposure::new(0, 2_000_000)], 0, |_, _, _| 1.0);
    let metas = |frames: &FrameSequence, with_events: bool| {
        let mut metas = BTreeMap::from([("frames".to_string(), vec![Meta::Frames(frames.meta.clone())])]);
        if with_events {
            metas.insert("events".to_string(), vec![Meta::Events(events().meta)]);
        }
        PortMetas::new(metas)
    };
    assert_eq!(
        node.plan(&metas(&one, true)).unwrap_err().message,
        "no wanted instant lies between two captured frames"
    );
    assert_eq!(node.plan(&metas(&frames(), false)).unwrap_err().param.as_deref(), Some("voxels"));
    let Meta::Frames(meta) = &node.plan(&metas(&frames(), true)).unwrap()[0] else { panic!("frames") };
    assert_eq!(meta.times.len(), 9);
}
