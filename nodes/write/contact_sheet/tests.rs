//! Tests of `write/contact_sheet`: which frame is shown, its greys, and what is refused.

use super::super::picture::load;
use super::super::testing::exporting;
use super::*;
use photocurrent_core::events::{Event, Polarity};
use photocurrent_core::{Exposure, FrameBlock, testing};
use std::collections::BTreeMap;
use std::path::Path;

const EXTENT: Extent = Extent { width: 48, height: 32 };

/// A bright disc that moves to the right; `gain` is the method's mistake.
fn disc(count: i64, gain: f32) -> FrameSequence {
    let exposures = (0..count).map(|l| Exposure::new(l * 1_000_000, l * 1_000_000 + 200_000)).collect();
    testing::captured(EXTENT, exposures, 0, |l, x, y| {
        let centre = 8.0 + 32.0 * l as f32 / count as f32;
        let distance = ((x as f32 - centre).powi(2) + (y as f32 - 16.0).powi(2)).sqrt();
        gain * (100.0 + 700.0 / (1.0 + libm::expf(distance - 6.0)) + 2.0 * y as f32)
    })
}

fn params(labels: &[&str]) -> Params {
    Params { labels: labels.iter().map(|label| label.to_string()).collect(), ..Params::default() }
}

fn draw_sheet(
    params: Params,
    frames: Vec<FrameSequence>,
    truth: Option<Truth>,
    look: impl FnOnce(Table, Vec<String>, &Path),
) {
    draw_all(params, In { frames, truth, events: None, sensor: None }, look);
}

fn draw_all(params: Params, input: In, look: impl FnOnce(Table, Vec<String>, &Path)) {
    let node = WriteContactSheet::build(params).unwrap();
    exporting(
        |cx| node.run(input, cx).unwrap(),
        |out, notes, folder| look((*out.listing).clone(), notes, folder),
    );
}

#[test]
fn the_nearest_exposure_middle_is_shown_and_listed() {
    // Middles at 0.1, 1.1, 2.1 ... ms; every fifth frame of the second sequence.
    let (all, some) = (disc(11, 1.0), disc(11, 0.6).select(vec![0, 5, 10]));
    draw_sheet(
        Params { columns: 3, ..params(&["all", "some"]) },
        vec![all, some],
        None,
        |listing, notes, folder| {
            assert_eq!(
                listing.column("t_ns"),
                Some(&Column::Integers(vec![100_000, 5_100_000, 10_100_000, 100_000, 5_100_000, 10_100_000]))
            );
            assert_eq!(listing.column("frame"), Some(&Column::Integers(vec![0, 5, 10, 0, 1, 2])));
            assert_eq!(listing.column("label").unwrap().cell(3), "some");
            assert!(notes[0].starts_with("contact_sheet.png is for looking only"), "{notes:?}");
            let (_, info) = load(&folder.join("contact_sheet.png"));
            // Three columns of 48 pixels fill 1600 dots at 11 dots a pixel.
            assert_eq!((info.width, info.color_type), (6 + 3 * (48 * 11 + 6), png::ColorType::Grayscale));
            assert!(info.uncompressed_latin1_text[0].text.contains("gamma 2.2"));
        },
    );
}

#[test]
fn all_rows_share_the_range_of_the_first_and_gamma_brightens_the_middle() {
    let flat = |dn: f32| {
        testing::captured(Extent { width: 2, height: 1 }, vec![Exposure::new(0, 10)], 0, move |_, x, _| {
            if x == 0 { 0.0 } else { dn }
        })
    };
    let params = Params { columns: 1, scale: Some(1), ..params(&["half", "twice"]) };
    draw_sheet(params, vec![flat(50.0), flat(200.0)], Some(Truth(flat(100.0))), |listing, _, folder| {
        assert_eq!(listing.column("label").unwrap().cell(0), "truth");
        let (values, info) = load(&folder.join("contact_sheet.png"));
        let layout =
            Layout::new(Crop { x: 0, y: 0, width: 2, height: 1 }, Some(1), 1, 3, font::width("0.000 ms"));
        assert_eq!((u64::from(info.width), u64::from(info.height)), (layout.width(), layout.height()));
        let row = |r: usize| {
            let at = (layout.picture_y(r) * info.width + layout.x(0)) as usize;
            values[at..at + 2].to_vec()
        };
        // 255 x 0.5^(1 / 2.2) = 186.08.
        assert_eq!([row(0), row(1), row(2)], [vec![0, 255], vec![0, 186], vec![0, 255]]);
    });
}

#[test]
fn a_crop_shows_the_part_that_was_asked_for() {
    let coordinates =
        testing::captured(EXTENT, vec![Exposure::new(0, 10)], 0, |_, x, y| (100 * y + x) as f32);
    let shown = read_cropped(&coordinates, 0, Crop { x: 3, y: 2, width: 2, height: 2 }).unwrap();
    assert_eq!(shown.dn, [203.0, 204.0, 303.0, 304.0]);
}

#[test]
fn colour_next_to_grey_gives_a_colour_sheet() {
    let grey =
        testing::captured(Extent { width: 2, height: 2 }, vec![Exposure::new(0, 10)], 0, |_, x, _| x as f32);
    let meta = FramesMeta {
        colour: photocurrent_core::Colour::Rgb,
        scale: FrameScale::Captured,
        ..(*grey.meta).clone()
    };
    let block =
        FrameBlock { frames: 0..1, rows: meta.extent.rows(), row_values: 6, dn: [1.0, 0.0, 0.0].repeat(4) };
    let red = FrameSequence::in_memory(Arc::new(meta), block);
    draw_sheet(
        Params { columns: 1, scale: Some(1), ..params(&["grey", "red"]) },
        vec![grey, red],
        None,
        |_, _, folder| {
            let (values, info) = load(&folder.join("contact_sheet.png"));
            assert_eq!(info.color_type, png::ColorType::Rgb);
            assert!(values.chunks(3).any(|dot| dot == [255, 0, 0]));
        },
    );
}

#[test]
fn rows_whose_numbers_stand_for_different_exposures_are_reported() {
    let of = |length: i64| testing::captured(EXTENT, vec![Exposure::new(0, length)], 0, |_, x, _| x as f32);
    draw_sheet(Params { columns: 1, ..params(&["a", "b"]) }, vec![of(10), of(20)], None, |_, notes, _| {
        assert_eq!(
            notes[0],
            "brightness differs by exposure: \"a\" has DN of 10 ns, \"b\" of 20 ns; \
                              connect `sensor` to show them alike"
        );
    });
}

fn event(x: u16, y: u16, polarity: Polarity, t: i64) -> Event {
    Event { x, y, polarity, t, t_in: None }
}

/// The colours of row `r` of a sheet of one column at one dot a pixel.
fn colours(folder: &Path, crop: Crop, rows: usize, r: usize) -> Vec<[u16; 3]> {
    let (values, info) = load(&folder.join("contact_sheet.png"));
    let layout = Layout::new(crop, Some(1), 1, rows, font::width("0.050 ms"));
    assert_eq!((u64::from(info.width), u64::from(info.height)), (layout.width(), layout.height()));
    let dots: Vec<[u16; 3]> = values.chunks(3).map(|dot| [dot[0], dot[1], dot[2]]).collect();
    let row = |y: u32| {
        (((layout.picture_y(r) + y) * info.width + layout.x(0)) as usize..).take(crop.width as usize)
    };
    (0..crop.height).flat_map(row).map(|at| dots[at]).collect()
}

#[test]
fn on_is_red_and_off_is_blue_and_what_is_outside_the_window_does_not_show() {
    let extent = Extent { width: 4, height: 3 };
    // The middle is at 50 us, so a window of 20 us goes from 40 us to just before 60 us.
    let frames = testing::captured(extent, vec![Exposure::new(0, 100_000)], 0, |_, x, _| x as f32);
    let (on, off) = (Polarity::On, Polarity::Off);
    let events = vec![
        event(0, 0, on, 50_000),
        event(1, 0, off, 50_000),
        event(2, 0, on, 39_999),
        event(3, 0, off, 60_000),
        event(0, 1, on, 40_000),
        event(0, 1, on, 59_999),
        event(1, 1, on, 45_000),
        event(1, 1, off, 46_000),
        event(1, 1, off, 47_000),
        event(3, 2, off, 48_000),
        event(3, 2, off, 49_000),
        event(3, 2, off, 50_000),
    ];
    let params = Params {
        columns: 1,
        scale: Some(1),
        window: Some(Duration::new(20_000)),
        full_colour: 2,
        ..params(&["seen"])
    };
    let input = || In {
        frames: vec![frames.clone()],
        truth: None,
        events: Some(testing::stream(extent, events.clone())),
        sensor: None,
    };
    let white = [255; 3];
    // One of two events is half the ink: 255 / 2 = 127.5. Beyond two, the colour is full.
    let (light_red, light_blue, red, blue) = ([255, 128, 128], [128, 128, 255], [255, 0, 0], [0, 0, 255]);
    draw_all(params.clone(), input(), |listing, _, folder| {
        let whole = Crop { x: 0, y: 0, width: 4, height: 3 };
        let both = [0, 0, 128];
        #[rustfmt::skip]
        let expected = [
            light_red, light_blue, white, white,
            red, both, white, white,
            white, white, white, blue,
        ];
        assert_eq!(colours(folder, whole, 2, 1), expected);
        // Frames only: the listing has no row of events.
        assert_eq!(listing.column("label"), Some(&Column::Texts(vec!["seen".into()])));
        // The grey row is still grey.
        assert!(colours(folder, whole, 2, 0).iter().all(|dot| dot[0] == dot[1] && dot[1] == dot[2]));
    });
    let crop = Crop { x: 1, y: 1, width: 3, height: 2 };
    draw_all(Params { crop: Some(crop), ..params.clone() }, input(), |_, _, folder| {
        assert_eq!(colours(folder, crop, 2, 1), [[0, 0, 128], white, white, white, white, blue]);
    });
    // With a clock that is 20 us late, what was recorded at 60 us happened at 40 us.
    let mut late = Sensor::unknown("late");
    late.effects
        .insert("clock_offset".into(), serde_json::json!({ "offset": "20 us" }).as_object().unwrap().clone());
    draw_all(params, In { sensor: Some(Arc::new(late)), ..input() }, |_, _, folder| {
        let shown = colours(folder, Crop { x: 0, y: 0, width: 4, height: 3 }, 2, 1);
        assert_eq!(shown.iter().filter(|dot| **dot != white).count(), 1);
        assert_eq!(shown[3], light_blue);
    });
}

#[test]
fn events_stand_below_truth_and_capture_for_as_long_as_an_exposure() {
    let captured = disc(3, 1.0);
    let meta = FramesMeta { scale: FrameScale::Nominal { exposure_ns: 200_000 }, ..(*captured.meta).clone() };
    let rendered = FrameSequence::in_memory(Arc::new(meta), captured.read(0..3, EXTENT.rows()).unwrap());
    let order = |sequences: &[&FrameSequence], truth| {
        row_of_events(&sequences.iter().map(|s| ("", *s)).collect::<Vec<_>>(), truth)
    };
    assert_eq!(order(&[&rendered, &captured, &rendered], true), 2);
    assert_eq!(order(&[&rendered, &rendered], true), 1);
    assert_eq!(order(&[&rendered, &captured], false), 0);
    let windows = |window, sequences: &[&FramesMeta]| {
        WriteContactSheet::build(Params { window, ..Params::default() })
            .unwrap()
            .windows(&[1_000_000], sequences)
    };
    assert_eq!(windows(None, &[&rendered.meta, &captured.meta]), [TimeSpan::new(900_000, 1_100_000)]);
    assert_eq!(windows(None, &[&rendered.meta]), [TimeSpan::new(-1_500_000, 3_500_000)]);
    assert_eq!(windows(Some(Duration::new(2001)), &[&captured.meta]), [TimeSpan::new(999_000, 1_001_001)]);
}

#[test]
fn with_the_black_level_frames_of_different_exposures_look_alike() {
    // 10 DN of darkness, then 0, 10 and 20 DN for each microsecond.
    let of = |us: i64| {
        testing::captured(
            Extent { width: 3, height: 1 },
            vec![Exposure::new(0, 1000 * us)],
            0,
            move |_, x, _| 10.0 + (10 * us as u32 * x) as f32,
        )
    };
    let mut sensor = Sensor::unknown("test");
    sensor.frames.black_level_dn = Some(10.0);
    let params = Params { columns: 1, scale: Some(1), ..params(&["short", "long"]) };
    let input = In { frames: vec![of(2), of(5)], truth: None, events: None, sensor: Some(Arc::new(sensor)) };
    draw_all(params, input, |_, notes, folder| {
        assert_eq!(notes.len(), 1, "{notes:?}");
        let (values, info) = load(&folder.join("contact_sheet.png"));
        let layout =
            Layout::new(Crop { x: 0, y: 0, width: 3, height: 1 }, Some(1), 1, 2, font::width("0.001 ms"));
        let row =
            |r: usize| values[(layout.picture_y(r) * info.width + layout.x(0)) as usize..][..3].to_vec();
        // 255 x 0.5^(1 / 2.2) = 186.08.
        assert_eq!([row(0), row(1)], [vec![0, 186, 255], vec![0, 186, 255]]);
    });
}

#[test]
fn instants_are_stated_or_spaced_over_the_common_time() {
    let (long, short) = (disc(11, 1.0), disc(11, 1.0).select((3..8).collect()));
    let instants =
        |params: Params| WriteContactSheet::build(params).unwrap().instants(&[&long.meta, &short.meta]);
    assert_eq!(instants(Params { columns: 3, ..Params::default() }), [3_100_000, 5_100_000, 7_100_000]);
    assert_eq!(
        instants(Params {
            columns: 1,
            start: Some(Duration::new(10)),
            end: Some(Duration::new(20)),
            ..Params::default()
        }),
        [15]
    );
    assert_eq!(instants(Params { times: Some(vec![Duration::new(7)]), ..Params::default() }), [7]);
    assert_eq!(nearest(&long.meta.times, i64::MAX), 10);
}

#[test]
fn what_cannot_be_drawn_is_refused_before_any_data() {
    let meta = |frames: &FrameSequence| Meta::Frames(frames.meta.clone());
    let plan = |params: Params, metas: Vec<Meta>| {
        WriteContactSheet::build(params)?
            .plan(&PortMetas::new(BTreeMap::from([("frames".to_string(), metas)])))
    };
    let (disc, other) = (disc(2, 1.0), testing::frames(5, 5, 2));
    assert!(plan(params(&["a"]), vec![meta(&disc)]).is_ok());
    let refused = |params: Params, metas: Vec<Meta>| plan(params, metas).unwrap_err().message;
    assert_eq!(
        refused(params(&["a", "b"]), vec![meta(&disc)]),
        "`labels` has 2 texts, and 1 input is connected to `frames`"
    );
    assert_eq!(
        refused(params(&["a", "b"]), vec![meta(&disc), meta(&other)]),
        "\"b\" has 5 x 5 pixels, and \"a\" has 48 x 32"
    );
    let crop = Some(Crop { x: 40, y: 0, width: 9, height: 1 });
    assert_eq!(
        refused(Params { crop, ..params(&["a"]) }, vec![meta(&disc)]),
        "`crop` asks for 9 x 1 pixels at (40, 0), and the frames have 48 x 32"
    );
    let events = Meta::Events(testing::events(5, 5).meta);
    let metas = PortMetas::new(BTreeMap::from([
        ("frames".to_string(), vec![meta(&disc)]),
        ("events".to_string(), vec![events]),
    ]));
    let error = WriteContactSheet::build(params(&["a"])).unwrap().plan(&metas).unwrap_err();
    assert_eq!(error.message, "the events have 5 x 5 pixels, and \"a\" has 48 x 32");
    let huge = Params { columns: 100, scale: Some(64), ..params(&["a", "b", "c", "d"]) };
    assert!(refused(huge, vec![meta(&disc); 4]).contains("the contact sheet would have"));
    assert!(refused(Params { columns: 0, ..params(&["a"]) }, vec![]).contains("1 to 100"));
}
