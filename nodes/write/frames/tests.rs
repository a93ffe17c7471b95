//! Claims about written frames.

use super::super::picture::load;
use super::super::testing::exporting;
use super::*;
use photocurrent_core::{Exposure, Extent, FrameBlock, testing};
use std::collections::BTreeMap;

const EXTENT: Extent = Extent { width: 5, height: 4 };

fn exposures(count: i64) -> Vec<Exposure> {
    (0..count).map(|l| Exposure::new(l * 10_000_000, l * 10_000_000 + 4_000_000)).collect()
}

fn write(frames: &FrameSequence, params: Params, look: impl FnOnce(Table, Vec<String>, &Path)) {
    write_with(None, frames, params, look);
}

fn write_with(
    sensor: Option<Arc<Sensor>>,
    frames: &FrameSequence,
    params: Params,
    look: impl FnOnce(Table, Vec<String>, &Path),
) {
    let node = WriteFrames::build(params).unwrap();
    exporting(
        |cx| node.run(In { frames: frames.clone(), sensor }, cx).unwrap(),
        |out, notes, folder| look((*out.listing).clone(), notes, folder),
    );
}

/// What a stranger's program reads from the folder: the numbers of the first line, and the lines of the
/// table.
fn read_csv(folder: &Path) -> (f64, f64, String, Vec<String>) {
    let text = std::fs::read_to_string(folder.join("frames.csv")).unwrap();
    let mut lines = text.lines().map(String::from);
    let first = lines.next().unwrap();
    let after = |key: &str| first.split(key).nth(1).unwrap().split([' ', ';']).next().unwrap().to_string();
    assert!(first.starts_with("# dn = offset + scale * code; offset="), "{first}");
    (
        after("offset=").parse().unwrap(),
        after("scale=").parse().unwrap(),
        after("exposure_dn_of_ns="),
        lines.collect(),
    )
}

#[test]
fn the_formula_of_the_first_line_gives_back_the_values() {
    let frames = testing::captured(EXTENT, exposures(3), 0, |l, x, y| {
        (l as f32 + 0.37) * (x as f32 - 1.5) * (y as f32 + 0.1) * 33.3
    });
    write(&frames, Params::default(), |listing, notes, folder| {
        let (offset, scale, exposure, lines) = read_csv(folder);
        assert_eq!(exposure, "4000000");
        assert_eq!(lines[0], "index,t_start_ns,t_end_ns,t_mid_ns,file,offset_dn,scale_dn");
        let fields: Vec<&str> = lines[2].split(',').collect();
        assert_eq!(fields[..5], ["1", "10000000", "14000000", "12000000", "000001.png"]);
        let number = |at: usize| fields[at].parse::<f64>().unwrap();
        assert_eq!((number(5), number(6)), (offset, scale), "each row has the code of its file");
        assert_eq!(lines.len(), 4);
        for l in 0..3 {
            let (codes, info) = load(&folder.join(format!("{l:06}.png")));
            assert_eq!(
                (info.bit_depth, info.color_type, info.gamma(), info.width, info.height),
                (BitDepth::Sixteen, png::ColorType::Grayscale, None, 5, 4)
            );
            let block = frames.read(l..l + 1, frames.rows()).unwrap();
            for (code, dn) in codes.iter().zip(&block.dn) {
                // Half a code is the best that rounding can do.
                assert!(
                    (offset + scale * f64::from(*code) - f64::from(*dn)).abs() <= 0.5000001 * scale,
                    "{code} is not {dn}"
                );
            }
        }
        assert_eq!(listing.column("file").unwrap().cell(2), "000002.png");
        assert_eq!(notes, [""; 0]);
        assert!(!folder.join("preview").exists());
    });
}

#[test]
fn the_code_spans_from_zero_or_the_lowest_value_to_the_highest() {
    let frames = testing::captured(EXTENT, exposures(2), 0, |l, x, _| 10.0 + (l * 100) as f32 + x as f32);
    write(&frames, Params::default(), |_, _, folder| {
        let (offset, scale, ..) = read_csv(folder);
        assert_eq!((offset, scale), (0.0, 114.0 / 65535.0));
        assert_eq!(load(&folder.join("000001.png")).0[4], 65535);
    });
    let dark = testing::captured(EXTENT, exposures(1), 0, |_, _, _| 0.0);
    write(&dark, Params::default(), |_, _, folder| assert_eq!(read_csv(folder).1, 1.0));
}

#[test]
fn unknown_and_clipped_values_are_counted() {
    let frames = testing::captured(EXTENT, exposures(1), 0, |_, x, y| match (x, y) {
        (0, 0) => f32::NAN,
        (1, 0) => -30.0,
        (2, _) => 700_000.0,
        _ => 5.0,
    });
    write(
        &frames,
        Params { scale: Some(10.0), offset: Some(0.0), ..Params::default() },
        |_, notes, folder| {
            let codes = load(&folder.join("000000.png")).0;
            assert_eq!(codes[..4], [0, 0, 65535, 1]);
            // One below 0 and four in column 2 lie outside of 0 ..= 655350 DN; 5 DN are half a code and
            // round away from zero.
            assert_eq!(
                notes,
                [
                    "1 values are not known (NaN) and were written as code 0",
                    "5 values lie outside of what the stated code can say and were clipped"
                ]
            );
        },
    );
}

#[test]
fn a_rolling_shutter_is_stated_and_rendered_frames_name_their_nominal_exposure() {
    let rolling = testing::frames(4, 3, 2);
    write(&rolling, Params::default(), |_, notes, folder| {
        let text = std::fs::read_to_string(folder.join("frames.csv")).unwrap();
        assert!(
            text.lines().next().unwrap().ends_with("; exposure_dn_of_ns=4000000; row_time_ns=10000"),
            "{text}"
        );
        assert!(notes[0].contains("those of row 0"), "{notes:?}");
    });
    let meta =
        FramesMeta { scale: FrameScale::Nominal { exposure_ns: 4_200_000 }, ..(*rolling.meta).clone() };
    let rendered = FrameSequence::new(
        Arc::new(meta),
        rolling.rows(),
        Arc::new(rolling.read_rows(rolling.rows()).unwrap()),
    );
    write(&rendered, Params::default(), |_, _, folder| assert_eq!(read_csv(folder).2, "4200000"));
}

#[test]
fn colour_is_written_as_rgb_and_a_preview_goes_to_another_folder() {
    let times = photocurrent_core::FrameTimes::new(exposures(1), 0).unwrap();
    let meta = FramesMeta {
        extent: Extent { width: 1, height: 1 },
        colour: photocurrent_core::Colour::Rgb,
        times,
        scale: FrameScale::Captured,
    };
    let block =
        FrameBlock { frames: 0..1, rows: meta.extent.rows(), row_values: 3, dn: vec![65535.0, 256.0, 0.0] };
    write(
        &FrameSequence::in_memory(Arc::new(meta), block),
        Params { preview: true, ..Params::default() },
        |_, notes, folder| {
            let (codes, info) = load(&folder.join("000000.png"));
            assert_eq!((codes, info.color_type), (vec![65535, 256, 0], png::ColorType::Rgb));
            let (codes, info) = load(&folder.join("preview/000000.png"));
            // White is the brightest of these three values; sRGB stores 256 / 65535 of light as 12.7 /
            // 255 (1.055 x^(1/2.4) - 0.055).
            assert_eq!((codes, info.bit_depth), (vec![255, 13, 0], BitDepth::Eight));
            assert!(
                notes[0].contains("for looking only: 8 bits, sRGB, black is 0 DN, white is 65535"),
                "{notes:?}"
            );
        },
    );
}

#[test]
fn saturation_sets_the_code_and_outliers_are_clipped_and_counted() {
    let mut sensor = Sensor::unknown("test");
    sensor.frames.saturation_dn = Some(255.0);
    let sensor = Some(Arc::new(sensor));
    let frames = testing::captured(EXTENT, exposures(2), 0, |l, x, y| match (l, x, y) {
        (0, 0, 0) => 74_000.0,
        (1, 1, 0) => 300.0,
        _ => 51.0,
    });
    write_with(sensor.clone(), &frames, Params::default(), |_, notes, folder| {
        let (offset, scale, ..) = read_csv(folder);
        assert_eq!((offset, scale), (0.0, 255.0 / 65535.0));
        // 51 DN of 255 is a fifth of 65535.
        assert_eq!(load(&folder.join("000000.png")).0[..2], [65535, 13107]);
        assert!(notes[0].starts_with("1 values are more than 20 times saturation"), "{notes:?}");
        assert!(
            notes[1].starts_with("2 values lie outside of what the code can say, up to saturation (255 DN)"),
            "{notes:?}"
        );
    });
    // A stated scale wins; a negative value lowers the offset, but no further than saturation is high.
    write_with(sensor.clone(), &frames, Params { scale: Some(2.0), ..Params::default() }, |_, _, folder| {
        assert_eq!(read_csv(folder).1, 2.0)
    });
    let negative = testing::captured(EXTENT, exposures(1), 0, |_, x, _| if x == 0 { -1e6 } else { 10.0 });
    write_with(sensor, &negative, Params::default(), |_, notes, folder| {
        assert_eq!(read_csv(folder).0, -255.0);
        assert!(notes[0].starts_with("4 values lie outside"), "{notes:?}");
    });
}

#[test]
fn without_a_saturation_an_outlier_that_sets_the_code_is_named() {
    let large = Extent { width: 50, height: 50 };
    let frames =
        testing::captured(large, exposures(1), 0, |_, x, y| if (x, y) == (7, 7) { 74_000.0 } else { 51.0 });
    write(&frames, Params::default(), |_, notes, _| {
        assert!(notes.iter().any(|note| note.contains("connect `sensor`")), "{notes:?}")
    });
    let dark = testing::captured(large, exposures(1), 0, |_, _, _| 0.0);
    write(&dark, Params::default(), |_, notes, _| assert_eq!(notes, [""; 0]));
}

#[test]
fn what_a_format_does_not_take_is_refused_by_name() {
    let refused = |params: Params| WriteFrames::build(params).err().and_then(|error| error.param);
    let f32 = Params { format: Format::Hdf5F32, ..Params::default() };
    assert_eq!(refused(f32.clone()), None);
    assert_eq!(refused(Params { scale: Some(1.0), ..f32.clone() }).as_deref(), Some("scale"));
    assert_eq!(refused(Params { offset: Some(1.0), ..f32.clone() }).as_deref(), Some("offset"));
    assert_eq!(refused(Params { preview: true, ..f32 }).as_deref(), Some("preview"));
    assert_eq!(refused(Params { format: Format::Hdf5U16, scale: Some(1.0), ..Params::default() }), None);
}

#[test]
fn one_file_of_codes_counts_what_codes_cannot_say() {
    let frames = testing::captured(EXTENT, exposures(3), 0, |l, x, _| {
        if (l, x) == (1, 0) { f32::NAN } else { 100.0 * x as f32 }
    });
    let params = Params { format: Format::Hdf5U16, scale: Some(1.0), offset: Some(200.0), preview: false };
    write(&frames, params, |listing, notes, folder| {
        assert_eq!(listing.column("file").unwrap().cell(2), "frames.h5");
        // Of three frames of four rows: one column unknown in one frame, and column 0 of two, column 1 of
        // three are below code 0.
        assert_eq!(
            notes,
            [
                "4 values are not known (NaN) and were written as code 0",
                "20 values lie outside of what the stated code can say and were clipped"
            ]
        );
        let names: Vec<_> =
            std::fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().file_name()).collect();
        assert_eq!(names, ["frames.h5"]);
    });
}

#[test]
fn mistakes_are_refused_before_anything_is_written() {
    assert_eq!(
        WriteFrames::build(Params { scale: Some(0.0), ..Params::default() }).err().unwrap().param.as_deref(),
        Some("scale")
    );
    let metas = PortMetas::new(BTreeMap::from([(
        "frames".to_string(),
        vec![Meta::Frames(testing::frames(2, 2, 0).meta)],
    )]));
    let error = WriteFrames::build(Params::default()).unwrap().plan(&metas).unwrap_err();
    assert_eq!(error.message, "`frames` has no frame to write");
}
