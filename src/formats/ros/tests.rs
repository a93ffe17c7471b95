//! Bags and MCAP files made byte by byte, read back; cut off at every length; changed at every byte.

use super::testing::{BagWriter, McapWriter, Packing, Wire, event_array, event_packet, evt3, image};
use crate::catalog::recognise;
use crate::chunk::EventChunk;
use crate::declared::Declared;
use crate::error::FormatError;
use crate::recording::Recording;
use photocurrent_core::{Colour, Extent};
use proptest::prelude::*;
use std::path::Path;

type Event = (i64, u16, u16, bool);

/// An opened file, which stays until the test has done with it: cursors open it again.
struct Opened {
    recording: Box<dyn Recording>,
    _folder: tempfile::TempDir,
}

impl std::ops::Deref for Opened {
    type Target = dyn Recording;

    fn deref(&self) -> &Self::Target {
        &*self.recording
    }
}

/// Writes bytes to a file and opens it as what it is.
fn opened(bytes: &[u8], declared: &Declared) -> Result<Opened, FormatError> {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("recording");
    std::fs::write(&path, bytes).unwrap();
    let format = recognise(&path)?.ok_or_else(|| FormatError::new(&path, "not recognised", ""))?;
    let recording = (format.open)(&path, declared)?;
    Ok(Opened { recording, _folder: folder })
}

fn open(bytes: &[u8]) -> Opened {
    opened(bytes, &Declared::default()).unwrap()
}

/// All events, and how many losses there were.
fn events(recording: &dyn Recording) -> (Vec<Event>, usize) {
    let mut cursor = recording.events().unwrap();
    let (mut chunk, mut all) = (EventChunk::default(), Vec::new());
    while cursor.next(&mut chunk).unwrap() {
        all.extend((0..chunk.len()).map(|k| (chunk.t[k], chunk.x[k], chunk.y[k], chunk.on[k] == 1)));
    }
    (all, cursor.losses().len())
}

fn declared_camera(camera: &str) -> Declared {
    Declared { camera: Some(camera.into()), ..Declared::default() }
}

const SECOND: i64 = 1_000_000_000;
const EPOCH: i64 = 1_700_000_000 * SECOND;

/// Messages of five events each, 1 ms apart.
fn arrays(messages: i64) -> Vec<Vec<Event>> {
    let event = |k: i64| (EPOCH + k * 200_000 + k, (k % 8) as u16, (k % 6) as u16, k % 3 == 0);
    (0..messages).map(|m| (5 * m..5 * m + 5).map(event).collect()).collect()
}

fn bag_of(packing: Packing, messages: i64, chunk: usize) -> BagWriter {
    let mut bag = BagWriter::new(packing).chunks_of(chunk);
    let id = bag.connect("/dvs/events", "dvs_msgs/EventArray");
    let pictures = bag.connect("/dvs/image_raw", "sensor_msgs/Image");
    for (m, events) in arrays(messages).iter().enumerate() {
        let received = EPOCH + (m as i64 + 1) * 1_000_000;
        bag.message(id, received, &event_array(Wire::Ros1, received, (8, 6), events));
        if m % 2 == 0 {
            let values: Vec<u8> = (0..48).map(|v| v + m as u8).collect();
            bag.message(
                pictures,
                received,
                &image(Wire::Ros1, received - 500_000, (8, 6), "mono8", 8, &values),
            );
        }
    }
    bag
}

fn mcap_of(packing: Packing, wire: Wire, messages: i64, chunk: usize) -> McapWriter {
    let mut file = McapWriter::new(packing).chunks_of(chunk);
    fill(&mut file, wire, messages);
    file
}

fn fill(file: &mut McapWriter, wire: Wire, messages: i64) {
    let id = file.connect("/dvs/events", "dvs_msgs/msg/EventArray", wire);
    let pictures = file.connect("/dvs/image_raw", "sensor_msgs/msg/Image", wire);
    for (m, events) in arrays(messages).iter().enumerate() {
        let received = EPOCH + (m as i64 + 1) * 1_000_000;
        file.message(id, received, &event_array(wire, received, (8, 6), events));
        if m % 2 == 0 {
            let values: Vec<u8> = (0..48).map(|v| v + m as u8).collect();
            file.message(pictures, received, &image(wire, received - 500_000, (8, 6), "mono8", 8, &values));
        }
    }
}

/// Ten messages as every container and serialisation has them.
fn ways() -> Vec<(String, Vec<u8>)> {
    let mut ways = Vec::new();
    for packing in [Packing::None, Packing::Bz2, Packing::Lz4] {
        ways.push((format!("bag {packing:?}"), bag_of(packing, 10, 400).finish().unwrap()));
    }
    for packing in [Packing::None, Packing::Lz4, Packing::Zstd] {
        for wire in [Wire::Ros1, Wire::Cdr, Wire::CdrBig] {
            ways.push((
                format!("mcap {packing:?} {wire:?}"),
                mcap_of(packing, wire, 10, 400).finish().unwrap(),
            ));
        }
    }
    let mut plain = McapWriter::new(Packing::None).without_chunks();
    fill(&mut plain, Wire::Cdr, 10);
    ways.push(("mcap without chunks".into(), plain.finish().unwrap()));
    ways
}

#[test]
fn every_container_and_serialisation_gives_the_same_events_and_pictures() {
    let wanted: Vec<Event> = arrays(10).concat();
    for (name, bytes) in ways() {
        let recording = open(&bytes);
        assert_eq!(events(&*recording), (wanted.clone(), 0), "{name}");
        let about = recording.events_about().unwrap();
        assert_eq!(about.extent, Some(Extent { width: 8, height: 6 }), "{name}");
        let pictures = recording.pictures().unwrap();
        assert_eq!(
            (pictures.about().colour, pictures.about().bits, pictures.about().stamps.len()),
            (Colour::Mono, 8, 5),
            "{name}"
        );
        let mut values = Vec::new();
        // Back and forth: the place within a chunk is found again.
        for frame in [0, 4, 1, 3, 2] {
            let m = 2 * frame as i64;
            assert_eq!(pictures.about().stamps[frame].at, EPOCH + (m + 1) * 1_000_000 - 500_000, "{name}");
            pictures.read(frame, &mut values).unwrap();
            assert_eq!(values, (0..48).map(|v| (v + m) as f32).collect::<Vec<_>>(), "{name}");
        }
        assert!(pictures.read(5, &mut values).is_err());
        assert!(recording.losses().is_empty(), "{name}: {:?}", recording.losses());
    }
}

/// One event array in ROS 1 as the message definitions lay it out, written by hand.
#[test]
fn a_message_written_by_hand_is_read() {
    let body: Vec<u8> = [
        &[9, 0, 0, 0][..],                            // header.seq
        &[0x00, 0xf1, 0x53, 0x65, 0x02, 0, 0, 0],     // header.stamp: 1,700,000,000 s and 2 ns
        &[3, 0, 0, 0, b'd', b'v', b's'],              // header.frame_id
        &[4, 1, 0, 0, 90, 1, 0, 0],                   // height 260, width 346
        &[1, 0, 0, 0],                                // one event
        &[44, 1, 200, 0],                             // x 300, y 200
        &[0x00, 0xf1, 0x53, 0x65, 0x40, 0x42, 15, 0], // 1,700,000,000 s and 1,000,000 ns
        &[1],
    ]
    .concat();
    let mut bag = BagWriter::new(Packing::None);
    let id = bag.connect("/e", "dvs_msgs/EventArray");
    bag.message(id, 5, &body);
    let recording = open(&bag.finish().unwrap());
    assert_eq!(events(&*recording).0, [(1_700_000_000 * SECOND + 1_000_000, 300, 200, true)]);
    assert_eq!(recording.events_about().unwrap().extent, Some(Extent { width: 346, height: 260 }));
}

/// Two events in CDR: the second begins at an even byte, and its time at one that 4 divides.
#[test]
fn events_in_cdr_are_aligned() {
    let body: Vec<u8> = [
        &[0, 1, 0, 0][..],
        &[0x00, 0xf1, 0x53, 0x65, 2, 0, 0, 0],    // stamp
        &[2, 0, 0, 0, b'c', 0],                   // frame_id with its zero byte: 14 bytes so far
        &[0, 0],                                  // to 16
        &[2, 0, 0, 0, 4, 0, 0, 0, 2, 0, 0, 0],    // height 2, width 4, two events: 28
        &[3, 0, 1, 0, 7, 0, 0, 0, 8, 0, 0, 0, 1], // x 3, y 1, 7 s 8 ns, ON: 41
        &[0],                                     // to 42
        &[2, 0, 0, 0, 0, 0],                      // x 2, y 0, to 48
        &[9, 0, 0, 0, 1, 0, 0, 0, 0],             // 9 s 1 ns, OFF
    ]
    .concat();
    let mut file = McapWriter::new(Packing::None);
    let id = file.connect("/e", "dvs_msgs/msg/EventArray", Wire::Cdr);
    file.message(id, 5, &body);
    let recording = open(&file.finish().unwrap());
    assert_eq!(events(&*recording), (vec![(7 * SECOND + 8, 3, 1, true), (9 * SECOND + 1, 2, 0, false)], 0));
}

#[test]
fn an_empty_topic_is_no_candidate_and_of_several_the_first_is_read_with_a_note() {
    let mut bag = BagWriter::new(Packing::None);
    let left = bag.connect("/left/events", "dvs_msgs/EventArray");
    bag.connect("/silent/events", "prophesee_event_msgs/EventArray");
    bag.message(left, 1, &event_array(Wire::Ros1, 1, (4, 4), &[(5, 1, 1, true)]));
    assert_eq!(events(&*open(&bag.finish().unwrap())).0, [(5, 1, 1, true)]);

    let mut bag = BagWriter::new(Packing::None);
    let ids =
        ["/left/events", "/right/events"].map(|topic| bag.connect(topic, "prophesee_event_msgs/EventArray"));
    for (x, id) in (0..).zip(ids) {
        bag.message(id, 1, &event_array(Wire::Ros1, 1, (4, 4), &[(5, x, 1, true)]));
    }
    let bytes = bag.finish().unwrap();
    let first = open(&bytes);
    assert_eq!(events(&*first).0, [(5, 0, 1, true)]);
    assert_eq!(
        first.events_about().unwrap().notes,
        ["events are those of /left/events; not read: /right/events (`camera` chooses)"]
    );
    assert_eq!(events(&*opened(&bytes, &declared_camera("/right/events")).unwrap()).0, [(5, 1, 1, true)]);
    assert!(opened(&bytes, &declared_camera("/up/events")).err().unwrap().found.contains("/right/events"));
}

/// A bag of two event cameras with pictures each, and of one camera that has no events.
fn stereo(topics: &[&str]) -> Vec<u8> {
    let mut bag = BagWriter::new(Packing::None);
    let events =
        ["/davis/right/events", "/davis/left/events"].map(|topic| bag.connect(topic, "dvs_msgs/EventArray"));
    for (x, id) in (0..).zip(events) {
        bag.message(id, 1, &event_array(Wire::Ros1, 1, (4, 2), &[(5, x, 1, true)]));
    }
    for (k, topic) in topics.iter().enumerate() {
        let id = bag.connect(topic, "sensor_msgs/Image");
        bag.message(id, 2, &image(Wire::Ros1, 2, (4, 2), "mono8", 4, &[k as u8; 8]));
    }
    bag.finish().unwrap()
}

#[test]
fn pictures_are_those_of_the_camera_whose_events_are_read() {
    let topics = ["/davis/right/image_raw", "/davis/left/image_raw", "/camera/color/image_raw"];
    let value = |recording: &Opened| {
        let mut values = Vec::new();
        recording.pictures().unwrap().read(0, &mut values).unwrap();
        values[0]
    };
    let left = open(&stereo(&topics));
    assert_eq!((events(&*left).0[0].1, value(&left)), (1, 1.0));
    assert!(left.events_about().unwrap().notes.contains(
        &"events are those of /davis/left/events; not read: /davis/right/events (`camera` chooses)".into()
    ));
    let notes = left.pictures().unwrap().about().notes.clone();
    assert!(
        notes.contains(
            &"pictures are those of /davis/left/image_raw; not read: /davis/right/image_raw, \
              /camera/color/image_raw (`frame_camera` chooses)"
                .into()
        ),
        "{notes:?}"
    );
    let right = opened(&stereo(&topics), &declared_camera("/davis/right/events")).unwrap();
    assert_eq!((events(&*right).0[0].1, value(&right)), (0, 0.0));
    // Names that are no kin of the events' decide nothing.
    let refused = opened(&stereo(&["/a/image_raw", "/b/image_raw"]), &Declared::default()).err().unwrap();
    assert_eq!(refused.undeclared, Some("frame_camera"));
    assert!(refused.found.contains("/a/image_raw") && refused.found.contains("/b/image_raw"), "{refused}");
}

/// uzh-rpg/rpg_dvs_ros#77: the driver states mono8 for the colour frames of a DAVIS346, "so the encoding is
/// wrong and it gets the sizes wrong too".
#[test]
fn three_channels_under_the_name_of_one_are_colour_and_padding_is_read_over() {
    let of = |encoding: &str, step: u32, values: &[u8]| {
        let mut bag = BagWriter::new(Packing::None);
        let id = bag.connect("/dvs/image_raw", "sensor_msgs/Image");
        bag.message(id, 2, &image(Wire::Ros1, 2, (4, 2), encoding, step, values));
        let recording = open(&bag.finish().unwrap());
        let pictures = recording.pictures().unwrap();
        let mut read = Vec::new();
        pictures.read(0, &mut read).unwrap();
        (pictures.about().colour, read, pictures.about().notes.join("; "))
    };
    let colour: Vec<u8> = (0..24).collect();
    let red_first: Vec<f32> =
        (0..8).flat_map(|k| [3 * k + 2, 3 * k + 1, 3 * k]).map(|value| value as f32).collect();
    for encoding in ["mono8", "8UC1", "bgr8", "8UC3"] {
        let (kind, read, notes) = of(encoding, 12, &colour);
        assert_eq!((kind, &read), (Colour::Rgb, &red_first), "{encoding}");
        let is_misnamed = encoding.ends_with("o8") || encoding.ends_with("C1");
        assert_eq!(notes.contains("rows have 12 bytes, and"), is_misnamed, "{notes}");
        assert_eq!(notes.contains("3 channels under a wrong name, read as bgr8"), is_misnamed, "{notes}");
    }
    assert_eq!(of("rgb8", 12, &colour).1, (0..24).map(|value| value as f32).collect::<Vec<_>>());
    let (kind, read, notes) = of("mono8", 16, &(0..32).collect::<Vec<u8>>());
    assert_eq!((kind, &read[..3], notes.contains("bgra8")), (Colour::Rgb, &[2.0, 1.0, 0.0][..], true));
    // A step that is no whole number of pixels, or values that are not there, is padding.
    let (kind, read, notes) = of("mono8", 6, &(0..12).collect::<Vec<u8>>());
    assert_eq!((kind, read), (Colour::Mono, vec![0.0, 1.0, 2.0, 3.0, 6.0, 7.0, 8.0, 9.0]));
    assert!(
        notes.contains("rows have 6 bytes, and mono8 of 4 columns needs 4: the others are taken as padding"),
        "{notes}"
    );
    let (kind, read, _) = of("mono16", 10, &(0..20).collect::<Vec<u8>>());
    assert_eq!((kind, read[4]), (Colour::Mono, f32::from(u16::from_le_bytes([10, 11]))));
    let (kind, read, _) = of("bayer_rggb8", 6, &(0..12).collect::<Vec<u8>>());
    assert_eq!((kind.channels(), read[4]), (1, 6.0));
    let (kind, read, _) = of("bgra8", 16, &(0..32).collect::<Vec<u8>>());
    assert_eq!((kind, &read[..3]), (Colour::Rgb, &[2.0, 1.0, 0.0][..]));
}

/// A packet every 10 ms over 40 s: the 24 bits of the sensor's microseconds begin again twice.
fn long_packets() -> (Vec<u8>, Vec<Event>) {
    let mut bag = BagWriter::new(Packing::Lz4).chunks_of(8_000);
    let id = bag.connect("/cam/events", "event_camera_msgs/EventPacket");
    let mut wanted = Vec::new();
    for packet in 0..4_000_i64 {
        let us = 3_000_000 + packet * 10_000;
        let events: Vec<Event> =
            (0..3).map(|k| (us + k * 1_000, (packet % 64) as u16, k as u16, k == 1)).collect();
        // The host learns of a packet at least 2 ms late; how late differs.
        let late = 2_000_000 + (packet * 7919 % 1000) * 1_000 * i64::from(packet != 5);
        let stamp = EPOCH + us * 1_000 + late;
        bag.message(
            id,
            stamp + 50_000,
            &event_packet(Wire::Ros1, stamp, (64, 48), (packet as u64, 0), "evt3", &evt3(&events)),
        );
        wanted.extend(events.iter().map(|(t, x, y, on)| (EPOCH + 2_000_000 + t * 1_000, *x, *y, *on)));
    }
    (bag.finish().unwrap(), wanted)
}

#[test]
fn sensor_times_come_to_the_clock_of_ros_by_one_constant() {
    let (bytes, wanted) = long_packets();
    let recording = open(&bytes);
    let about = recording.events_about().unwrap();
    // Packet 5 was the quickest of the first 64: exactly 2 ms late. The sensor's zero lies at EPOCH.
    assert!(about.notes[0].starts_with(&format!("{} ns added", EPOCH + 2_000_000)), "{:?}", about.notes);
    assert_eq!(about.tick_ns, 1000);
    assert_eq!(events(&*recording), (wanted, 0));
}

#[test]
fn after_a_seek_no_later_event_is_missing_and_wraps_are_known() {
    let (bytes, wanted) = long_packets();
    let recording = open(&bytes);
    let mut cursor = recording.events().unwrap();
    let mut chunk = EventChunk::default();
    let end = wanted.last().unwrap().0;
    for t in
        [i64::MIN, 0, wanted[0].0, wanted[3].0, wanted[6_001].0 + 1, wanted[9_500].0, end, end + 1, i64::MAX]
    {
        cursor.seek(t).unwrap();
        let mut all: Vec<Event> = Vec::new();
        while cursor.next(&mut chunk).unwrap() {
            all.extend((0..chunk.len()).map(|k| (chunk.t[k], chunk.x[k], chunk.y[k], chunk.on[k] == 1)));
        }
        let first_after = wanted.iter().position(|event| event.0 >= t).unwrap_or(wanted.len());
        assert!(all.len() >= wanted.len() - first_after, "{t}");
        assert_eq!(all, wanted[wanted.len() - all.len()..], "{t}");
        // Near the end, most of the file is left out.
        assert!(t < wanted[9_500].0 || all.len() < 4_000, "{t}: {}", all.len());
    }
}

#[test]
fn missing_packets_are_reported_and_their_wraps_are_found() {
    let mut bag = BagWriter::new(Packing::None);
    let id = bag.connect("/cam/events", "event_camera_msgs/EventPacket");
    // 40 s between both packets: two wraps that no word shows.
    for (sequence, us) in [(0_u64, 1_000_000_i64), (9, 41_000_000)] {
        let body = event_packet(
            Wire::Ros1,
            EPOCH + us * 1_000,
            (64, 48),
            (sequence, 0),
            "evt3",
            &evt3(&[(us, 1, 2, true)]),
        );
        bag.message(id, EPOCH + us * 1_000, &body);
    }
    let recording = open(&bag.finish().unwrap());
    let mut cursor = recording.events().unwrap();
    let mut chunk = EventChunk::default();
    cursor.next(&mut chunk).unwrap();
    assert_eq!(chunk.t, [EPOCH + SECOND, EPOCH + 41 * SECOND]);
    assert_eq!(cursor.losses().len(), 1);
    assert!(cursor.losses()[0].what.contains("8 packets before it are missing"), "{:?}", cursor.losses());
}

#[test]
fn other_encodings_of_packets_are_read_or_refused_by_name() {
    let packet = |encoding: &str, base: u64, events: &[u8]| {
        let mut bag = BagWriter::new(Packing::None);
        let id = bag.connect("/cam/events", "event_camera_msgs/EventPacket");
        bag.message(id, EPOCH, &event_packet(Wire::Ros1, EPOCH, (640, 480), (0, base), encoding, events));
        opened(&bag.finish().unwrap(), &Declared::default())
    };
    // mono: 1,000 ns after the base, x 5, y 7, ON. The first event gets the packet's stamp.
    let mono = (1_000_u64 | 5 << 32 | 7 << 48 | 1 << 63).to_le_bytes();
    let later = (1_250_u64 | 6 << 32 | 7 << 48).to_le_bytes();
    let recording = packet("mono", 77, &[mono, later].concat()).unwrap();
    assert_eq!(events(&*recording).0, [(EPOCH, 5, 7, true), (EPOCH + 250, 6, 7, false)]);
    // libcaer: valid, ON, y 7, x 5; 3 us after the base, which is a ROS time.
    let caer = (1_u64 | 1 << 1 | 7 << 2 | 5 << 17 | 3 << 32).to_le_bytes();
    let recording = packet("libcaer", 5_000, &caer).unwrap();
    assert_eq!(events(&*recording).0, [(8_000, 5, 7, true)]);
    // libcaer_cmp: time 1 << 12 | 2 us, column 5; row 7 ON; then from row 8, OFF, the first and the third.
    let words: [u16; 6] = [1, 0x1002, 0x2005, 0x3807, 0x4008, 0x5005];
    let recording = packet("libcaer_cmp", 5_000, &words.map(u16::to_le_bytes).concat()).unwrap();
    let t = 5_000 + 4_098_000;
    assert_eq!(events(&*recording).0, [(t, 5, 7, true), (t, 5, 8, false), (t, 5, 10, false)]);
    let refused = packet("evt9", 0, &[0; 8]).err().unwrap();
    assert!(
        refused.to_string().contains("`evt9`") && refused.to_string().contains("libcaer_cmp"),
        "{refused}"
    );
}

#[test]
fn triggers_of_evt3_come_to_the_same_clock() {
    let mut bag = BagWriter::new(Packing::None);
    let id = bag.connect("/cam/events", "event_camera_msgs/EventPacket");
    // An event at 100 us, then time 150 us and a rising edge on line 6.
    let words =
        [evt3(&[(100, 1, 2, true)]), [0x6000 | 150_u16, 0xa601].map(u16::to_le_bytes).concat()].concat();
    bag.message(id, EPOCH, &event_packet(Wire::Ros1, EPOCH, (64, 48), (0, 0), "evt3", &words));
    let triggers = open(&bag.finish().unwrap()).triggers().unwrap();
    assert_eq!(triggers, [crate::Trigger { t: EPOCH + 50_000, line: 6, edge: crate::Edge::Rising }]);
}

#[test]
fn values_of_pictures_follow_encoding_step_and_byte_order() {
    let read = |encoding: &str, size: (u32, u32), step: u32, values: &[u8], big: bool| {
        let mut body = image(Wire::Ros1, 10, size, encoding, step, values);
        let place = body.len() - values.len() - 9;
        body[place] = u8::from(big);
        let mut bag = BagWriter::new(Packing::None);
        let id = bag.connect("/cam/image_raw", "sensor_msgs/Image");
        bag.message(id, 11, &body);
        let recording = opened(&bag.finish().unwrap(), &Declared::default())?;
        let pictures = recording.pictures().unwrap();
        let mut all = Vec::new();
        pictures.read(0, &mut all)?;
        Ok::<_, FormatError>((pictures.about().colour.name(), pictures.about().bits, all))
    };
    assert_eq!(read("rgb8", (1, 1), 3, &[1, 2, 3], false).unwrap(), ("rgb", 8, vec![1.0, 2.0, 3.0]));
    assert_eq!(read("bgr8", (1, 1), 3, &[1, 2, 3], false).unwrap(), ("rgb", 8, vec![3.0, 2.0, 1.0]));
    assert_eq!(
        read("bgra8", (2, 1), 8, &[1, 2, 3, 9, 4, 5, 6, 9], false).unwrap().2,
        [3.0, 2.0, 1.0, 6.0, 5.0, 4.0]
    );
    assert_eq!(
        read("mono16", (1, 2), 3, &[1, 2, 9, 3, 4], false).unwrap(),
        ("mono", 16, vec![513.0, 1027.0])
    );
    assert_eq!(read("mono16", (1, 2), 3, &[1, 2, 9, 3, 4], true).unwrap().2, [258.0, 772.0]);
    assert_eq!(
        read("bayer_grbg8", (2, 2), 3, &[1, 2, 9, 3, 4], false).unwrap(),
        ("bayer_grbg", 8, vec![1.0, 2.0, 3.0, 4.0])
    );
    let refused = read("yuv422", (2, 1), 4, &[0; 4], false).unwrap_err();
    assert!(refused.found.contains("`yuv422`") && refused.expected.unwrap().contains("mono8"));
}

#[test]
fn a_picture_without_a_stamp_has_the_time_of_receipt_and_says_so() {
    let mut bag = BagWriter::new(Packing::None);
    let id = bag.connect("/cam/image_raw", "sensor_msgs/Image");
    bag.message(id, 77, &image(Wire::Ros1, 0, (1, 1), "mono8", 1, &[5]));
    let recording = open(&bag.finish().unwrap());
    let pictures = recording.pictures().unwrap();
    assert_eq!(pictures.about().stamps[0].at, 77);
    assert!(pictures.about().notes.iter().any(|note| note.contains("1 pictures have no `header.stamp`")));
}

#[test]
fn a_recording_without_an_index_is_read_and_says_so() {
    let wanted: Vec<Event> = arrays(10).concat();
    let files = [
        bag_of(Packing::Lz4, 10, 400).unfinished().unwrap(),
        mcap_of(Packing::Zstd, Wire::Cdr, 10, 400).unfinished().unwrap(),
    ];
    for bytes in files {
        let recording = open(&bytes);
        assert_eq!(events(&*recording), (wanted.clone(), 0));
        assert_eq!(recording.losses().len(), 1);
        assert!(recording.losses()[0].what.contains("its recorder was stopped, or it is cut off"));
        assert_eq!(recording.pictures().unwrap().about().stamps.len(), 5);
    }
}

/// Whatever is left of a file: its whole messages from the start, in order.
#[test]
fn a_file_that_is_cut_off_gives_what_is_whole() {
    let wanted: Vec<Event> = arrays(6).concat();
    let files = [
        bag_of(Packing::None, 6, 300).finish().unwrap(),
        bag_of(Packing::Bz2, 6, 300).finish().unwrap(),
        mcap_of(Packing::None, Wire::Cdr, 6, 300).finish().unwrap(),
        mcap_of(Packing::Zstd, Wire::Cdr, 6, 300).finish().unwrap(),
    ];
    for bytes in files {
        let mut most = 0;
        // The header of a bag is filled with spaces: cutting there gives nothing.
        let start = if bytes.starts_with(b"#ROSBAG") { 4109 } else { 0 };
        for length in (start..bytes.len()).step_by(3) {
            let Ok(recording) = opened(&bytes[..length], &Declared::default()) else { continue };
            if recording.events_about().is_none() {
                continue;
            }
            let (got, losses) = events(&*recording);
            assert_eq!(got, wanted[..got.len()], "cut at {length}");
            assert!(
                got.len() >= most,
                "cut at {length}: {} events where {most} were there before",
                got.len()
            );
            assert!(!recording.losses().is_empty() || losses > 0, "cut at {length}");
            most = got.len();
        }
        assert_eq!(most, wanted.len());
    }
}

/// A chunk that is damaged is lost alone, with and without an index.
#[test]
fn what_stands_around_a_damaged_chunk_is_read() {
    for finished in [true, false] {
        let bag = bag_of(Packing::Lz4, 10, 300);
        let mut bytes = if finished { bag.finish().unwrap() } else { bag.unfinished().unwrap() };
        // The header of the second chunk: its header length becomes nonsense.
        let needle = b"compression=lz4";
        let second =
            bytes.windows(needle.len()).enumerate().filter(|(_, window)| window == needle).nth(1).unwrap().0;
        bytes[second - 5] = 0xff;
        let recording = open(&bytes);
        let (got, losses) = events(&*recording);
        let wanted: Vec<Event> = arrays(10).concat();
        assert!(got.len() < wanted.len() && got.len() >= wanted.len() - 15, "{}", got.len());
        assert!(got.iter().all(|event| wanted.contains(event)));
        assert_eq!(got.last(), wanted.last());
        assert!(losses + recording.losses().len() > 0);
    }
}

/// Opens and reads all that can be read; must neither panic nor loop.
fn read_all(bytes: &[u8]) {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("recording");
    std::fs::write(&path, bytes).unwrap();
    read_path(&path);
}

fn read_path(path: &Path) {
    let Ok(Some(format)) = recognise(path) else { return };
    let Ok(recording) = (format.open)(path, &Declared::default()) else { return };
    let mut chunk = EventChunk::default();
    if let Ok(mut cursor) = recording.events() {
        while cursor.next(&mut chunk).unwrap() {}
        cursor.seek(EPOCH).unwrap();
        cursor.next(&mut chunk).unwrap();
        assert!(cursor.losses().len() < 200);
    }
    if let Some(pictures) = recording.pictures() {
        let mut values = Vec::new();
        for frame in 0..pictures.about().stamps.len() {
            let _ = pictures.read(frame, &mut values);
        }
    }
    let _ = recording.triggers();
}

#[test]
fn every_changed_byte_is_survived() {
    for (name, bytes) in ways()
        .into_iter()
        .filter(|(name, _)| ["bag None", "bag Lz4", "mcap Zstd Cdr"].contains(&name.as_str()))
    {
        let first = if name.starts_with("bag") { 4109 } else { 0 };
        for place in (0..100).chain(first..bytes.len()).step_by(7) {
            for change in [0x01, 0xff] {
                let mut changed = bytes.clone();
                changed[place] ^= change;
                read_all(&changed);
            }
        }
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    #[test]
    fn random_bytes_behind_the_magic_are_survived(
        tail in proptest::collection::vec(any::<u8>(), 0..600),
        mcap in any::<bool>(),
    ) {
        let magic: &[u8] = if mcap { b"\x89MCAP0\r\n" } else { b"#ROSBAG V2.0\n" };
        read_all(&[magic, &tail].concat());
    }

    #[test]
    fn several_random_changes_are_survived(
        changes in proptest::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 1..12),
        way in 0..13_usize,
    ) {
        let (_, mut bytes) = ways().swap_remove(way);
        for (place, byte) in changes {
            let place = place.index(bytes.len());
            bytes[place] = byte;
        }
        read_all(&bytes);
    }
}
