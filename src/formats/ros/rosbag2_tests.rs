//! Bags of ROS 2: the one that the library rosbags wrote (`data/formats/make_rosbag2.py`), and others made
//! here; cut, changed, split, compressed.

use super::testing::{McapWriter, Packing, Wire, compressed_image, db3, event_array, image};
use crate::catalog::recognise;
use crate::chunk::EventChunk;
use crate::declared::Declared;
use crate::error::FormatError;
use crate::recording::Recording;
use photocurrent_core::{Colour, Extent, colour::Order};
use std::path::Path;

type Event = (i64, u16, u16, bool);
type Message = (u32, i64, Vec<u8>);

const EPOCH: i64 = 1_700_000_000_000_000_000;
const TOPICS: [(&str, &str); 3] = [
    ("/dvs/events", "dvs_msgs/msg/EventArray"),
    ("/cam/image_raw", "sensor_msgs/msg/Image"),
    ("/imu", "sensor_msgs/msg/Imu"),
];

fn example(name: &str) -> Vec<u8> {
    std::fs::read(Path::new(env!("CARGO_MANIFEST_DIR")).join("../../data/formats").join(name)).unwrap()
}

fn some(count: i64) -> Vec<Event> {
    (0..count)
        .map(|k| (EPOCH + 1_000_000 + 37_000 * k, (7 * k % 32) as u16, (5 * k % 24) as u16, k % 3 == 0))
        .collect()
}

/// Ten events to a message, and a picture after each.
fn messages(count: i64) -> Vec<Message> {
    let mut all = Vec::new();
    for (m, part) in some(10 * count).chunks(10).enumerate() {
        let t = EPOCH + 1_000_000 * (m as i64 + 2);
        all.push((0, t, event_array(Wire::Cdr, t, (32, 24), part)));
        all.push((1, t, image(Wire::Cdr, t - 500_000, (8, 6), "mono8", 8, &[m as u8; 48])));
        all.push((2, t, vec![0, 1, 0, 0, 9]));
    }
    all
}

/// A folder with files, which stays until the test has done with it.
struct Bench(tempfile::TempDir);

impl Bench {
    fn new(files: &[(&str, Vec<u8>)]) -> Bench {
        let folder = tempfile::tempdir().unwrap();
        files.iter().for_each(|(name, bytes)| std::fs::write(folder.path().join(name), bytes).unwrap());
        Bench(folder)
    }

    fn open(&self, name: &str, declared: &Declared) -> Result<Box<dyn Recording>, FormatError> {
        let path = self.0.path().join(name);
        let format = recognise(&path)?.unwrap_or_else(|| panic!("{name} is recognised"));
        assert_eq!(format.id, "rosbag2");
        (format.open)(&path, declared)
    }

    fn whole(&self, name: &str) -> Box<dyn Recording> {
        self.open(name, &Declared::default()).unwrap()
    }
}

fn events(recording: &dyn Recording) -> (Vec<Event>, Vec<String>) {
    let mut cursor = recording.events().unwrap();
    let (mut chunk, mut all) = (EventChunk::default(), Vec::new());
    while cursor.next(&mut chunk).unwrap() {
        all.extend((0..chunk.len()).map(|k| (chunk.t[k], chunk.x[k], chunk.y[k], chunk.on[k] == 1)));
    }
    (all, cursor.losses().iter().map(|loss| format!("{}: {}", loss.at, loss.what)).collect())
}

fn pictures(recording: &dyn Recording) -> Vec<Vec<f32>> {
    let pictures = recording.pictures().unwrap();
    let mut values = Vec::new();
    (0..pictures.about().stamps.len())
        .map(|frame| pictures.read(frame, &mut values).map(|()| values.clone()).unwrap())
        .collect()
}

#[test]
fn a_bag_written_by_rosbags_gives_its_events_and_both_its_cameras() {
    let bench = Bench::new(&[("a.db3", example("rosbag2.db3"))]);
    let several = bench.open("a.db3", &Declared::default()).err().unwrap();
    assert_eq!(several.undeclared, Some("frame_camera"));
    let camera = |name: &str| Declared { frame_camera: Some(name.into()), ..Declared::default() };
    let raw = bench.open("a.db3", &camera("/cam/image_raw")).unwrap();
    assert_eq!(events(&*raw), (some(40), vec![]));
    assert_eq!(raw.events_about().unwrap().extent, Some(Extent { width: 32, height: 24 }));
    for (m, values) in pictures(&*raw).iter().enumerate() {
        assert!(values.iter().enumerate().all(|(k, value)| *value == (k + 10 * m) as f32), "picture {m}");
    }
    let at: Vec<i64> = raw.pictures().unwrap().about().stamps.iter().map(|stamp| stamp.at - EPOCH).collect();
    assert_eq!(at, [1_500_000, 2_500_000, 3_500_000, 4_500_000]);
    let colour = bench.open("a.db3", &camera("cam/colour/compressed")).unwrap();
    assert_eq!(
        (colour.pictures().unwrap().about().colour, colour.pictures().unwrap().about().bits),
        (Colour::Rgb, 8)
    );
    let all = pictures(&*colour);
    assert_eq!(all.len(), 4);
    for pixel in all.iter().flat_map(|values| values.as_chunks::<3>().0) {
        assert!(pixel.iter().zip([200.0, 100.0, 50.0]).all(|(a, b)| (a - b).abs() <= 2.0), "{pixel:?}");
    }
}

#[test]
fn messages_that_were_compressed_one_by_one_are_the_same() {
    let plain = messages(6);
    let packed: Vec<Message> = plain
        .iter()
        .map(|(id, t, body)| (*id, *t, zstd::stream::encode_all(body.as_slice(), 3).unwrap()))
        .collect();
    let bench =
        Bench::new(&[("a.db3", db3(&TOPICS, &plain).unwrap()), ("b.db3", db3(&TOPICS, &packed).unwrap())]);
    let (a, b) = (bench.whole("a.db3"), bench.whole("b.db3"));
    assert_eq!(events(&*a), (some(60), vec![]));
    assert_eq!(events(&*a), events(&*b));
    assert_eq!(pictures(&*a), pictures(&*b));
}

#[test]
fn seeking_leaves_out_no_event_at_or_after_the_time() {
    // Long enough for several pieces.
    let bench = Bench::new(&[("a.db3", db3(&TOPICS, &messages(1500)).unwrap())]);
    let recording = bench.whole("a.db3");
    let all = some(15_000);
    assert_eq!(events(&*recording), (all.clone(), vec![]));
    for wanted in [0, 7_000, 14_990] {
        let t = all[wanted].0;
        let (mut cursor, mut chunk, mut got) =
            (recording.events().unwrap(), EventChunk::default(), Vec::new());
        cursor.seek(t).unwrap();
        while cursor.next(&mut chunk).unwrap() {
            got.extend(chunk.t.iter().copied());
        }
        let first = got[0];
        assert_eq!(got.iter().filter(|at| **at >= t).count(), all.len() - wanted);
        assert!(wanted < 14_000 || first > all[3_000].0, "random access does not begin at the front");
    }
}

fn split(names: [&str; 2], metadata: &str) -> Vec<(String, Vec<u8>)> {
    let all = messages(8);
    let (first, second) = all.split_at(12);
    // The second file numbers its topics in another order.
    let other = [TOPICS[1], TOPICS[2], TOPICS[0]];
    let second: Vec<Message> = second.iter().map(|(id, t, body)| ((id + 2) % 3, *t, body.clone())).collect();
    vec![
        (names[0].into(), db3(&TOPICS, first).unwrap()),
        (names[1].into(), db3(&other, &second).unwrap()),
        ("metadata.yaml".into(), metadata.as_bytes().to_vec()),
    ]
}

fn folder(files: &[(String, Vec<u8>)]) -> Bench {
    let files: Vec<(&str, Vec<u8>)> =
        files.iter().map(|(name, bytes)| (name.as_str(), bytes.clone())).collect();
    Bench::new(&files)
}

#[test]
fn a_split_bag_is_read_in_the_order_of_its_description() {
    let listed = "rosbag2_bagfile_information:\n  version: 4\n  relative_file_paths:\n    - \
                  bag/z_0.db3\n    - bag/a_1.db3\n  ros_distro: humble\n";
    let bench = folder(&split(["z_0.db3", "a_1.db3"], listed));
    let recording = bench.whole("");
    assert_eq!(events(&*recording), (some(80), vec![]));
    assert_eq!(
        pictures(&*recording).iter().map(|values| values[0]).collect::<Vec<_>>(),
        [0.0, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0]
    );
    assert_eq!((recording.files().len(), recording.losses().len()), (3, 0));
    assert!(recording.facts().contains(&("ROS".into(), "humble".into())));
}

#[test]
fn a_split_bag_without_a_sound_description_is_read_by_its_names_and_says_so() {
    for text in ["]] no yaml", "", "rosbag2_bagfile_information:\n  relative_file_paths: 7\n"] {
        let bench = folder(&split(["bag_9.db3", "bag_10.db3"], text));
        let recording = bench.whole("");
        assert_eq!(events(&*recording).0, some(80), "{text}");
        assert!(
            recording.losses()[0].what.contains("in the order of their names"),
            "{:?}",
            recording.losses()
        );
    }
}

#[test]
fn a_missing_and_a_damaged_file_of_a_split_bag_are_losses() {
    let listed = "rosbag2_bagfile_information:\n  relative_file_paths: [bag_0.db3, bag_1.db3, bag_2.db3]\n";
    let mut files = split(["bag_0.db3", "bag_1.db3"], listed);
    let missing = folder(&files).whole("").losses();
    assert!(
        missing.len() == 1 && missing[0].at == "bag_2.db3" && missing[0].what.contains("not in the folder"),
        "{missing:?}"
    );
    files[1].1 = b"SQLite format 3\0 and no more".to_vec();
    let bench = folder(&files);
    let recording = bench.whole("");
    assert_eq!(events(&*recording).0, some(40));
    assert!(recording.losses().iter().any(|loss| loss.at == "bag_1.db3"), "{:?}", recording.losses());
}

#[test]
fn a_folder_of_mcap_files_is_a_bag_as_well() {
    let part = |from: usize, to: usize| {
        let mut file = McapWriter::new(Packing::Zstd);
        TOPICS.iter().for_each(|(name, kind)| {
            file.connect(name, kind, Wire::Cdr);
        });
        messages(8)[from..to].iter().for_each(|(id, t, body)| file.message(*id as u16, *t, body));
        file.finish().unwrap()
    };
    let metadata = b"rosbag2_bagfile_information:\n  relative_file_paths: [b_0.mcap, b_1.mcap]\n".to_vec();
    let bench =
        Bench::new(&[("b_0.mcap", part(0, 9)), ("b_1.mcap", part(9, 24)), ("metadata.yaml", metadata)]);
    let recording = bench.whole("");
    assert_eq!(events(&*recording), (some(80), vec![]));
    // Manifests that name read/mcap go on.
    let by_mcap =
        (crate::catalog::named("mcap").unwrap().open)(bench.0.path(), &Declared::default()).unwrap();
    assert_eq!(events(&*by_mcap).0, some(80));
}

#[test]
fn a_file_that_was_compressed_as_a_whole_is_refused_with_the_command() {
    let packed = zstd::stream::encode_all(db3(&TOPICS, &messages(30)).unwrap().as_slice(), 3).unwrap();
    let metadata = b"rosbag2_bagfile_information:\n  relative_file_paths: [bag_0.db3.zstd]\n".to_vec();
    let bench = Bench::new(&[("bag_0.db3.zstd", packed), ("metadata.yaml", metadata)]);
    for name in ["bag_0.db3.zstd", ""] {
        let error = bench.open(name, &Declared::default()).err().unwrap();
        assert!(error.hint.contains("zstd -d bag_0.db3.zstd") && error.found.contains("SQLite"), "{error}");
    }
    std::fs::write(bench.0.path().join("bag_0.db3"), db3(&TOPICS, &messages(30)).unwrap()).unwrap();
    assert_eq!(events(&*bench.whole("")), (some(300), vec![]));
}

#[test]
fn a_database_that_is_no_bag_says_what_it_lacks() {
    let make = |text: &str| {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.db3");
        let database = rusqlite::Connection::open(&path).unwrap();
        database.execute_batch(text).unwrap();
        drop(database);
        std::fs::read(path).unwrap()
    };
    let topics = "CREATE TABLE topics(id INTEGER PRIMARY KEY, name TEXT, type TEXT, serialization_format \
                  TEXT); INSERT INTO topics VALUES (1, '/e', 'dvs_msgs/msg/EventArray', 'cdr');";
    let cases = [
        (make("CREATE TABLE bookmarks(id INTEGER, url TEXT)"), "no table `topics`"),
        (make(topics), "no table `messages`"),
        // Nothing that computes is read: it could do any work.
        (
            make(&format!(
                "{topics} CREATE VIEW messages AS WITH RECURSIVE c(n) AS (SELECT 1 UNION ALL SELECT n + 1 \
                 FROM c) SELECT n AS id, 1 AS topic_id, n AS timestamp, zeroblob(9) AS data FROM c"
            )),
            "no table `messages`",
        ),
        (
            make(&format!("{topics} CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id INTEGER, \
                           timestamp INTEGER, data BLOB AS (zeroblob(999999999)))")),
            "no ordinary table",
        ),
        (b"SQLite format 3\0".to_vec(), "cannot be"),
        (b"SQLite format 3\0 and then text that is no database at all, as long as a header is, which has one \
           hundred bytes".to_vec(), "cannot be"),
    ];
    for (bytes, expected) in cases {
        let bench = Bench::new(&[("a.db3", bytes)]);
        let error = bench.open("a.db3", &Declared::default()).err().unwrap();
        assert!(
            error.found.contains(expected)
                && error.expected.as_deref().unwrap_or_default().contains("`topics` and `messages`"),
            "{error}"
        );
    }
}

#[test]
fn a_database_that_is_cut_off_or_damaged_in_a_page_gives_what_is_whole() {
    let whole = db3(&TOPICS, &messages(200)).unwrap();
    let all = some(2_000);
    for pages in [20, 60, whole.len() / 1024 - 3] {
        let bench = Bench::new(&[("a.db3", whole[..pages * 1024].to_vec())]);
        let Ok(recording) = bench.open("a.db3", &Declared::default()) else { continue };
        let (got, _) = events(&*recording);
        assert!(got.iter().all(|event| all.contains(event)), "{pages} pages");
        assert!(
            recording.losses().iter().any(|loss| loss.what.contains("cut off")),
            "{:?}",
            recording.losses()
        );
        assert!(pages < 60 || got.len() > 200, "{pages} pages give {} events", got.len());
    }
    // A page of the middle becomes noise.
    let mut bytes = whole.clone();
    let middle = whole.len() / 1024 / 2 * 1024;
    bytes[middle..middle + 1024].fill(0x5a);
    let bench = Bench::new(&[("a.db3", bytes)]);
    let recording = bench.whole("a.db3");
    let (got, _) = events(&*recording);
    assert!(got.len() > 1_700 && got.len() < 2_000 && got.last() == all.last(), "{} events", got.len());
    assert!(!recording.losses().is_empty());
}

#[test]
fn a_log_that_was_not_merged_is_a_loss_and_a_name_of_any_bytes_is_opened() {
    use std::os::unix::ffi::OsStrExt;
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join(std::ffi::OsStr::from_bytes(b"50% of #1?\xff.db3"));
    std::fs::write(&path, db3(&TOPICS, &messages(3)).unwrap()).unwrap();
    let mut log = path.clone().into_os_string();
    log.push("-wal");
    std::fs::write(log, "pages").unwrap();
    let recording = (recognise(&path).unwrap().unwrap().open)(&path, &Declared::default()).unwrap();
    assert_eq!(events(&*recording).0, some(30));
    assert!(recording.losses()[0].what.contains("wal_checkpoint"), "{:?}", recording.losses());
}

/// The bytes of a grey PNG of 16 bits, or of 8.
fn png(width: u32, height: u32, values: &[u16], depth: png::BitDepth) -> Vec<u8> {
    let mut out = Vec::new();
    let mut encoder = png::Encoder::new(&mut out, width, height);
    encoder.set_color(png::ColorType::Grayscale);
    encoder.set_depth(depth);
    let bytes: Vec<u8> = match depth {
        png::BitDepth::Sixteen => values.iter().flat_map(|value| value.to_be_bytes()).collect(),
        _ => values.iter().map(|value| *value as u8).collect(),
    };
    encoder.write_header().unwrap().write_image_data(&bytes).unwrap();
    out
}

fn compressed(
    topics: &[(&str, &str)],
    bodies: &[(u32, &str, Vec<u8>)],
    declared: &Declared,
) -> Result<Box<dyn Recording>, FormatError> {
    let message = |(k, (id, format, bytes)): (usize, &(u32, &str, Vec<u8>))| {
        let t = EPOCH + 1_000_000 * k as i64;
        (*id, t, compressed_image(Wire::Cdr, t, format, bytes))
    };
    let messages: Vec<Message> = bodies.iter().enumerate().map(message).collect();
    let bench = Bench::new(&[("a.db3", db3(topics, &messages).unwrap())]);
    let recording = bench.open("a.db3", declared);
    // Pictures are read from the file: it stays.
    std::mem::forget(bench);
    recording
}

const COMPRESSED: (&str, &str) = ("/cam/compressed", "sensor_msgs/msg/CompressedImage");

#[test]
fn compressed_pictures_have_the_bits_and_the_mosaic_that_their_format_names() {
    let values: Vec<u16> = (0..12).map(|k| 5_000 * k).collect();
    let open = |format: &str, bytes: Vec<u8>| {
        compressed(&[COMPRESSED], &[(0, format, bytes.clone()), (0, format, bytes)], &Declared::default())
            .unwrap()
    };
    let deep = open("16UC1; png compressed ", png(4, 3, &values, png::BitDepth::Sixteen));
    let about = deep.pictures().unwrap().about().clone();
    assert_eq!(
        (about.bits, about.colour, about.extent, about.transfer),
        (16, Colour::Mono, Extent { width: 4, height: 3 }, None)
    );
    assert_eq!(pictures(&*deep), vec![values.iter().map(|value| f32::from(*value)).collect::<Vec<f32>>(); 2]);
    let mosaic = open("bayer_grbg8; png compressed ", png(2, 2, &[1, 2, 3, 4], png::BitDepth::Eight));
    assert_eq!(mosaic.pictures().unwrap().about().colour, Colour::Bayer(Order::Grbg));
    for format in ["jpeg", "bgr8; jpeg compressed bgr8", "rgb8; jpeg compressed bgr8"] {
        let colour = open(format, example("colour.jpg"));
        let first = pictures(&*colour).remove(0);
        assert!((first[0] - 200.0).abs() < 6.0 && first[2] < 6.0, "{format}: {:?}", &first[..3]);
    }
}

#[test]
fn a_compressed_copy_of_raw_pictures_is_no_second_camera_and_depth_is_none_at_all() {
    let depth = ("/cam/image_raw/compressedDepth", "sensor_msgs/msg/CompressedImage");
    let copy = ("/cam/image_raw/compressed", "sensor_msgs/msg/CompressedImage");
    let mut all = messages(2);
    let coded =
        |k: i64| compressed_image(Wire::Cdr, EPOCH + k, "mono8; jpeg compressed ", &example("grey.jpg"));
    all.push((3, EPOCH, coded(1)));
    all.push((4, EPOCH, compressed_image(Wire::Cdr, EPOCH, "16UC1; compressedDepth png", &[0; 40])));
    let topics = [TOPICS[0], TOPICS[1], TOPICS[2], copy, depth];
    let bench = Bench::new(&[("a.db3", db3(&topics, &all).unwrap())]);
    assert_eq!(bench.whole("a.db3").pictures().unwrap().about().extent, Extent { width: 8, height: 6 });
    assert!(
        bench
            .whole("a.db3")
            .facts()
            .iter()
            .any(|(name, what)| name == "not read" && what.contains("compressedDepth"))
    );
    let named = |name: &str| Declared { frame_camera: Some(name.into()), ..Declared::default() };
    assert_eq!(
        bench.open("a.db3", &named(copy.0)).unwrap().pictures().unwrap().about().extent,
        Extent { width: 16, height: 8 }
    );
    let lost = bench.open("a.db3", &named(depth.0)).unwrap();
    assert!(
        lost.pictures().is_none() && lost.losses()[0].what.contains("compressedDepth"),
        "{:?}",
        lost.losses()
    );
}

#[test]
fn other_codings_are_refused_and_broken_pictures_are_left_out() {
    let error = compressed(&[COMPRESSED], &[(0, "h264", vec![0, 0, 0, 1, 0x67])], &Declared::default())
        .err()
        .unwrap();
    assert!(error.found.contains("`h264`") && error.hint.contains("republish compressed raw"), "{error}");
    let depth =
        compressed(&[COMPRESSED], &[(0, "16UC1; compressedDepth png", vec![0; 40])], &Declared::default())
            .err()
            .unwrap();
    assert!(depth.hint.contains("no picture of a camera"), "{depth}");
    let whole = example("grey.jpg");
    let broken = compressed(
        &[COMPRESSED],
        &[(0, "jpeg", whole.clone()), (0, "jpeg", whole[..30].to_vec()), (0, "jpeg", whole)],
        &Declared::default(),
    )
    .unwrap();
    assert_eq!((pictures(&*broken).len(), broken.losses().len()), (2, 1));
}
