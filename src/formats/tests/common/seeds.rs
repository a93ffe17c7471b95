//! Small whole recordings of every format, made here byte by byte; HDF5 files are those of `data/formats`.

use super::Seed;
use photocurrent_core::Extent;
use photocurrent_formats::aedat3::made as made3;
use photocurrent_formats::aedat4::made;
use photocurrent_formats::ros::testing::{
    BagWriter, McapWriter, Packing, Wire, compressed_image, db3, event_array, event_packet, evt3, image,
};
use photocurrent_formats::{Column, Declared, TimeUnit};
use std::path::Path;

type Event = (i64, u16, u16, bool);

/// Events of a small sensor, time in us.
fn events() -> Vec<Event> {
    (0..40).map(|k| (1_000 + 37 * k, (k * 7 % 32) as u16, (k * 5 % 24) as u16, k % 3 == 0)).collect()
}

/// What formats leave open.
fn declared() -> Declared {
    Declared {
        extent: Some(Extent { width: 32, height: 24 }),
        time_unit: Some(TimeUnit::Us),
        columns: Some(vec![Column::T, Column::X, Column::Y, Column::P]),
        ..Declared::default()
    }
}

/// All of them; at least one of every format in the catalogue.
pub fn all() -> Vec<Seed> {
    [prophesee(), older(), aedat3(), aedat4(), ros(), hdf(), text(), numpy(), pictures()].concat()
}

fn prophesee() -> Vec<Seed> {
    let header = |version: &str| format!("% evt {version}\n% geometry 32x24\n% end\n").into_bytes();
    let words2 = events().into_iter().flat_map(|(t, x, y, on)| {
        let high = 8 << 28 | (t >> 6) as u32;
        [
            high,
            u32::from(on) << 28 | (t as u32 & 63) << 22 | u32::from(x) << 11 | u32::from(y),
            10 << 28 | (t as u32 & 63) << 22 | 1,
        ]
    });
    let words21 = events().into_iter().flat_map(|(t, x, y, on)| {
        let high = 8 << 60 | (t as u64 >> 6) << 32;
        [
            high,
            u64::from(on) << 60
                | (t as u64 & 63) << 54
                | u64::from(x & !31) << 43
                | u64::from(y) << 32
                | 1 << (x & 31),
        ]
    });
    let vectors: [u16; 9] = [0x8001, 0x6002, 0x0003, 0x3804, 0x4fff, 0x5081, 0xa101, 0xe005, 0x7001];
    let records = events()
        .into_iter()
        .flat_map(|(t, x, y, on)| [t as u32, u32::from(on) << 28 | u32::from(y) << 14 | u32::from(x)]);
    let evt3 = [evt3(&events()), vectors.map(u16::to_le_bytes).concat()].concat();
    let dat = b"% Data file containing CD events.\n% Version 2\n% Width 32\n% Height 24\n\x00\x08".to_vec();
    vec![
        Seed::file(
            "evt2",
            "a.raw",
            [header("2.0"), words2.flat_map(u32::to_le_bytes).collect()].concat(),
            &Declared::default(),
        ),
        Seed::file(
            "evt21",
            "a.raw",
            [header("2.1"), words21.flat_map(u64::to_le_bytes).collect()].concat(),
            &Declared::default(),
        ),
        Seed::file("evt3", "a.raw", [header("3.0"), evt3].concat(), &Declared::default()),
        Seed::file(
            "dat",
            "a.dat",
            [dat, records.flat_map(u32::to_le_bytes).collect()].concat(),
            &Declared::default(),
        ),
    ]
}

fn older() -> Vec<Seed> {
    let head = b"#!AER-DAT2.0\r\n# AEChip: eu.seebetter.ini.chips.davis.Davis346blue\r\n".to_vec();
    let record = |(t, x, y, on): Event| {
        [
            (u32::from(y) << 22 | u32::from(x) << 12 | u32::from(on) << 11).to_be_bytes(),
            (t as u32).to_be_bytes(),
        ]
        .concat()
    };
    let aedat2 = [head, events().into_iter().flat_map(record).collect()].concat();
    let stream = |kind: u8| {
        let step = |(_, x, y, on): Event| {
            let first = if kind == 1 { 37 << 1 | u8::from(on) } else { 37 << 2 | u8::from(on) << 1 };
            [&[first][..], &x.to_le_bytes(), &y.to_le_bytes(), if x == 0 { &[0xff] } else { &[] }].concat()
        };
        [
            &b"Event Stream\x02\x00\x00"[..],
            &[kind, 32, 0, 24, 0],
            &events().into_iter().flat_map(step).collect::<Vec<u8>>(),
        ]
        .concat()
    };
    vec![
        Seed::file("aedat2", "a.aedat", aedat2, &Declared::default()),
        Seed::file("event_stream", "a.es", stream(1), &Declared::default()),
        Seed::file("event_stream", "b.es", stream(2), &Declared::default()),
    ]
}

fn aedat3() -> Vec<Seed> {
    let values: Vec<u16> = (0..48).map(|k| k << 6).collect();
    let of = |camera: &str| {
        let parts = [
            made3::header(camera),
            made3::polarity(0, &events()[..20]),
            made3::frame(0, (1, 0), (1_400, 1_600), (8, 6), &values),
            made3::special(0, &[(1_100, 2), (1_200, 3)]),
            made3::polarity(1, &events()[20..]),
            made3::frame(1, (1, 0), (1_800, 1_900), (8, 6), &values),
        ];
        parts.concat()
    };
    let declared = Declared { extent: Some(Extent { width: 32, height: 24 }), ..Declared::default() };
    vec![
        Seed::file("aedat3", "a.aedat", of("prototype"), &declared),
        Seed::file("aedat3", "b.aedat", of("DVS128"), &Declared::default()),
    ]
}

fn aedat4() -> Vec<Seed> {
    let of = |how: made::How, with_table: bool| {
        let some: Vec<(i64, i16, i16, u8)> =
            events().into_iter().map(|(t, x, y, on)| (t, x as i16, y as i16, u8::from(on))).collect();
        let pixels: Vec<u8> = (0..48).collect();
        let pieces = [
            made::events(0, &some[..20]),
            made::frame(1, 1_500, (1_400, 1_600), 0, (8, 6), &pixels),
            made::triggers(2, &[(1_100, 1), (1_200, 2)]),
            made::events(0, &some[20..]),
        ];
        made::file(how, &[("EVTS", 32, 24), ("FRME", 8, 6), ("TRIG", 0, 0)], &pieces, with_table)
    };
    let ways = made::How::ALL.into_iter().flat_map(|how| [(how, true), (how, false)]);
    ways.map(|(how, with_table)| Seed::file("aedat4", "a.aedat4", of(how, with_table), &Declared::default()))
        .collect()
}

fn ros() -> Vec<Seed> {
    let ns: Vec<Event> = events().into_iter().map(|(t, x, y, on)| (t * 1000, x, y, on)).collect();
    let pixels: Vec<u8> = (0..48).collect();
    let messages = |wire: Wire| {
        let mut messages = Vec::new();
        for (k, part) in ns.chunks(10).enumerate() {
            let t = 1_000_000 * (k as i64 + 2);
            messages.push((0, t, event_array(wire, t, (32, 24), part)));
            messages.push((1, t, image(wire, t, (8, 6), ["mono8", "bgr8", "mono8", "mono8"][k], 8, &pixels)));
        }
        messages
    };
    let packets = |wire: Wire| {
        let part = |(k, part): (usize, &[Event])| {
            (
                0,
                5_000_000 * k as i64,
                event_packet(wire, 5_000_000 * k as i64, (32, 24), (k as u64, 0), "evt3", &evt3(part)),
            )
        };
        events().chunks(10).enumerate().map(part).collect::<Vec<_>>()
    };
    let mut seeds = Vec::new();
    for packing in [Packing::None, Packing::Bz2, Packing::Lz4] {
        let mut bag = BagWriter::new(packing).chunks_of(500);
        bag.connect("/dvs/events", "dvs_msgs/EventArray");
        bag.connect("/dvs/image_raw", "sensor_msgs/Image");
        messages(Wire::Ros1).iter().for_each(|(id, t, body)| bag.message(*id, *t, body));
        seeds.push(Seed::file("rosbag", "a.bag", bag.finish().unwrap(), &Declared::default()));
    }
    let mut bag = BagWriter::new(Packing::None);
    bag.connect("/cam/events", "event_camera_msgs/EventPacket");
    packets(Wire::Ros1).iter().for_each(|(id, t, body)| bag.message(*id, *t, body));
    seeds.push(Seed::file("rosbag", "b.bag", bag.unfinished().unwrap(), &Declared::default()));
    for packing in [Packing::None, Packing::Lz4, Packing::Zstd] {
        let mut file = McapWriter::new(packing).chunks_of(500);
        file.connect("/dvs/events", "dvs_msgs/msg/EventArray", Wire::Cdr);
        file.connect("/dvs/image_raw", "sensor_msgs/msg/Image", Wire::Cdr);
        messages(Wire::Cdr).iter().for_each(|(id, t, body)| file.message(*id as u16, *t, body));
        seeds.push(Seed::file("mcap", "a.mcap", file.finish().unwrap(), &Declared::default()));
    }
    let mut file = McapWriter::new(Packing::None).without_chunks();
    file.connect("/cam/events", "event_camera_msgs/msg/EventPacket", Wire::Cdr);
    packets(Wire::Cdr).iter().for_each(|(id, t, body)| file.message(*id as u16, *t, body));
    seeds.push(Seed::file("mcap", "b.mcap", file.unfinished().unwrap(), &Declared::default()));
    let mut file = McapWriter::new(Packing::None);
    file.connect("/dvs/image_raw/compressed", "sensor_msgs/msg/CompressedImage", Wire::Cdr);
    for (k, name) in ["colour.jpg", "progressive.jpg", "colour.jpg"].into_iter().enumerate() {
        let t = 1_000_000 * (k as i64 + 2);
        file.message(0, t, &compressed_image(Wire::Cdr, t, "bgr8; jpeg compressed bgr8", &example(name)));
    }
    seeds.push(Seed::file("mcap", "c.mcap", file.finish().unwrap(), &Declared::default()));
    let topics = [("/dvs/events", "dvs_msgs/msg/EventArray"), ("/dvs/image_raw", "sensor_msgs/msg/Image")];
    let plain: Vec<(u32, i64, Vec<u8>)> = messages(Wire::Cdr);
    let packed: Vec<(u32, i64, Vec<u8>)> = plain
        .iter()
        .map(|(id, t, body)| (*id, *t, zstd::stream::encode_all(body.as_slice(), 1).unwrap()))
        .collect();
    let halves = [db3(&topics, &plain[..4]).unwrap(), db3(&topics, &plain[4..]).unwrap()];
    let metadata =
        b"rosbag2_bagfile_information:\n  version: 5\n  relative_file_paths:\n  - bag_0.db3\n  - bag_1.db3\n"
            .to_vec();
    let [first, second] = halves;
    seeds.push(Seed::file("rosbag2", "a.db3", db3(&topics, &plain).unwrap(), &Declared::default()));
    seeds.push(Seed::file("rosbag2", "b.db3", db3(&topics, &packed).unwrap(), &Declared::default()));
    let declared = Declared { frame_camera: Some("/cam/colour/compressed".into()), ..Declared::default() };
    seeds.push(Seed::file("rosbag2", "c.db3", example("rosbag2.db3"), &declared));
    let files =
        vec![("metadata.yaml".into(), metadata), ("bag_0.db3".into(), first), ("bag_1.db3".into(), second)];
    seeds.push(Seed { format: "rosbag2", files, declared: Declared::default() });
    seeds
}

/// A file of `data/formats`.
fn example(name: &str) -> Vec<u8> {
    // Of this crate, or of the command, whose tests share this file.
    let here = Path::new(env!("CARGO_MANIFEST_DIR"));
    let folder = ["../../data/formats", "data/formats"]
        .into_iter()
        .map(|folder| here.join(folder))
        .find(|folder| folder.is_dir())
        .unwrap();
    std::fs::read(folder.join(name)).unwrap()
}

fn hdf() -> Vec<Seed> {
    let of =
        |(format, name): (&'static str, &str)| Seed::file(format, name, example(name), &Declared::default());
    [
        ("dsec", "dsec_blosc_zstd.h5"),
        ("m3ed", "m3ed.h5"),
        ("mvsec", "mvsec.h5"),
        ("event_utils_hdf5", "event_utils.h5"),
        ("v2e_hdf5", "v2e.h5"),
        ("prophesee_hdf5", "prophesee_plain.h5"),
        ("prophesee_hdf5", "prophesee_ecf.h5"),
        // Our own files have the same layout of events, and are read by their own reader first.
        ("recording", "dsec_blosc_zstd.h5"),
    ]
    .map(of)
    .to_vec()
}

fn text() -> Vec<Seed> {
    let lines = |separator: &str| {
        events()
            .iter()
            .map(|(t, x, y, on)| {
                [*t, i64::from(*x), i64::from(*y), i64::from(*on)].map(|n| n.to_string()).join(separator)
                    + "\n"
            })
            .collect::<String>()
    };
    let seconds: String =
        events().iter().map(|(t, x, y, on)| format!("0.{t:06} {x} {y} {}\n", u8::from(*on))).collect();
    let folder = vec![
        ("events.txt".into(), seconds.into_bytes()),
        ("images.txt".into(), b"0.001000 images/a.png\n0.002000 images/b.png\n".to_vec()),
        ("images/a.png".into(), png(8, 6, 1)),
        ("images/b.png".into(), png(8, 6, 2)),
        ("calib.txt".into(), b"200.0 200.0 16.0 12.0 0.1 0.0 0.0 0.0 0.0\n".to_vec()),
    ];
    vec![
        Seed::file("csv", "a.csv", format!("t,x,y,p\n{}", lines(",")).into_bytes(), &declared()),
        Seed::file("csv", "b.txt", format!("# t x y p\n# unit us\n{}", lines(" ")).into_bytes(), &declared()),
        Seed { format: "ecd", files: folder, declared: Declared::default() },
    ]
}

/// A grey picture.
fn png(width: u32, height: u32, value: u8) -> Vec<u8> {
    let mut bytes = Vec::new();
    let mut encoder = png::Encoder::new(&mut bytes, width, height);
    encoder.set_color(png::ColorType::Grayscale);
    let mut writer = encoder.write_header().unwrap();
    writer.write_image_data(&vec![value; (width * height) as usize]).unwrap();
    drop(writer);
    bytes
}

/// An npy file: version 1.0, its header filled up to 64 bytes.
fn npy(kind: &str, shape: &str, data: Vec<u8>) -> Vec<u8> {
    let mut header = format!("{{'descr': '{kind}', 'fortran_order': False, 'shape': ({shape}), }}");
    while !(10 + header.len() + 1).is_multiple_of(64) {
        header.push(' ');
    }
    header.push('\n');
    [b"\x93NUMPY\x01\x00", &(header.len() as u16).to_le_bytes()[..], header.as_bytes(), &data].concat()
}

/// A zip archive of deflated or stored members.
fn archive(members: &[(&str, Vec<u8>)], deflated: bool) -> Vec<u8> {
    let (mut out, mut directory) = (Vec::new(), Vec::new());
    for (name, bytes) in members {
        let mut crc = flate2::Crc::new();
        crc.update(bytes);
        let packed = if deflated {
            let mut encoder = flate2::write::DeflateEncoder::new(Vec::new(), flate2::Compression::fast());
            std::io::Write::write_all(&mut encoder, bytes).unwrap();
            encoder.finish().unwrap()
        } else {
            bytes.clone()
        };
        let at = out.len() as u32;
        let method: u16 = if deflated { 8 } else { 0 };
        let common = [
            &[20, 0, 0, 0][..],
            &method.to_le_bytes(),
            &[0, 0, 0x21, 0],
            &crc.sum().to_le_bytes(),
            &(packed.len() as u32).to_le_bytes(),
            &(bytes.len() as u32).to_le_bytes(),
            &(name.len() as u16).to_le_bytes(),
            &[0, 0],
        ]
        .concat();
        out.extend([b"PK\x03\x04", &common[..], name.as_bytes(), &packed].concat());
        directory.extend(
            [b"PK\x01\x02\x14\x00", &common[..], &[0; 10], &at.to_le_bytes(), name.as_bytes()].concat(),
        );
    }
    let count = (members.len() as u16).to_le_bytes();
    let end = [
        b"PK\x05\x06\0\0\0\0",
        &count[..],
        &count,
        &(directory.len() as u32).to_le_bytes(),
        &(out.len() as u32).to_le_bytes(),
        &[0, 0],
    ]
    .concat();
    [out, directory, end].concat()
}

fn numpy() -> Vec<Seed> {
    let t: Vec<u8> = events().iter().flat_map(|event| event.0.to_le_bytes()).collect();
    let x: Vec<u8> = events().iter().flat_map(|event| event.1.to_le_bytes()).collect();
    let y: Vec<u8> = events().iter().flat_map(|event| event.2.to_le_bytes()).collect();
    let p: Vec<u8> = events().iter().map(|event| u8::from(event.3)).collect();
    let members = [
        ("t.npy", npy("<i8", "40,", t.clone())),
        ("x.npy", npy("<u2", "40,", x)),
        ("y.npy", npy("<u2", "40,", y)),
        ("p.npy", npy("|u1", "40,", p.clone())),
    ];
    let rows: Vec<u8> = events()
        .iter()
        .flat_map(|(t, x, y, on)| [*t as f64, f64::from(*x), f64::from(*y), f64::from(u8::from(*on))])
        .flat_map(f64::to_le_bytes)
        .collect();
    let seconds: Vec<u8> = events().iter().flat_map(|event| (event.0 as f64 * 1e-6).to_le_bytes()).collect();
    let xy: Vec<u8> =
        events().iter().flat_map(|event| [event.1, event.2]).flat_map(u16::to_le_bytes).collect();
    let memmap = vec![
        ("events_ts.npy".into(), npy("<f8", "40,", seconds)),
        ("events_xy.npy".into(), npy("<u2", "40, 2", xy)),
        ("events_p.npy".into(), npy("|u1", "40,", p)),
        ("images.npy".into(), npy("|u1", "2, 6, 8, 1", (0..96).collect())),
        (
            "images_ts.npy".into(),
            npy("<f8", "2,", [0.001_f64, 0.002].iter().flat_map(|t| t.to_le_bytes()).collect()),
        ),
        ("metadata.json".into(), b"{\"sensor_resolution\": [24, 32]}".to_vec()),
    ];
    let sequence = vec![
        ("events/000000.npz".into(), archive(&[&members[..2], &members[2..]].concat(), true)),
        ("images/000000.png".into(), png(32, 24, 3)),
        ("images/000001.png".into(), png(32, 24, 9)),
        ("images/timestamp.txt".into(), b"1000\n2500\n".to_vec()),
        ("timestamp.txt".into(), b"1000\n2500\n".to_vec()),
    ];
    vec![
        Seed::file("npz", "a.npz", archive(&members, true), &declared()),
        Seed::file("npz", "b.npz", archive(&members, false), &declared()),
        Seed::file("npz", "c.npy", npy("<f8", "40, 4", rows), &declared()),
        Seed { format: "memmap", files: memmap, declared: Declared::default() },
        Seed { format: "hs_ergb", files: sequence, declared: Declared::default() },
    ]
}

fn pictures() -> Vec<Seed> {
    let mut video = b"YUV4MPEG2 W8 H6 F25:1 Ip A1:1 Cmono\n".to_vec();
    (0..2).for_each(|k: u8| video.extend([b"FRAME\n".to_vec(), vec![k; 48]].concat()));
    let folder = vec![
        ("a.png".into(), png(8, 6, 1)),
        ("b.png".into(), png(8, 6, 2)),
        ("timestamps.txt".into(), b"1000\n2000\n".to_vec()),
    ];
    let photos = vec![
        ("a.jpg".into(), example("grey.jpg")),
        ("b.jpeg".into(), example("grey.jpg")),
        ("timestamps.txt".into(), b"1000\n2000\n".to_vec()),
    ];
    let scans = vec![
        ("a.tif".into(), tiff(8, 6)),
        ("b.tif".into(), tiff(8, 6)),
        ("timestamps.txt".into(), b"1000\n2000\n".to_vec()),
    ];
    vec![
        Seed::file("pictures", "a.y4m", video, &declared()),
        Seed { format: "pictures", files: folder, declared: declared() },
        Seed { format: "pictures", files: scans, declared: declared() },
        Seed { format: "pictures", files: photos, declared: declared() },
    ]
}

/// A grey 8-bit TIFF in one strip.
fn tiff(width: u16, height: u16) -> Vec<u8> {
    let bytes = u32::from(width) * u32::from(height);
    let entry = |tag: u16, kind: u16, value: u32| {
        [&tag.to_le_bytes()[..], &kind.to_le_bytes(), &1_u32.to_le_bytes(), &value.to_le_bytes()].concat()
    };
    let entries = [
        entry(256, 3, width.into()),
        entry(257, 3, height.into()),
        entry(258, 3, 8),
        entry(259, 3, 1),
        entry(262, 3, 1),
        entry(273, 4, 8),
        entry(277, 3, 1),
        entry(278, 3, height.into()),
        entry(279, 4, bytes),
    ];
    let head = [b"II\x2a\x00", &(8 + bytes).to_le_bytes()[..]].concat();
    let values: Vec<u8> = (0..bytes as u8).collect();
    [head, values, (entries.len() as u16).to_le_bytes().to_vec(), entries.concat(), vec![0; 4]].concat()
}
