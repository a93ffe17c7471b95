//! A small recording with known light: a bright disc crosses a striped ramp, 96 x 72 pixels, 0.3 s; and
//! writers of the files that people have.
//!
//! Events have a threshold of 0.25 in log(1 + light) and exact times; frames of 10 ms begin every 20 ms, from
//! 2 ms on, in 8 bits. No event lies below row 63 or above row 22: the disc does not reach them. [`score`]
//! compares rendered frames with the light, in rows 20 to 65; frames are read as sRGB there, as `init`
//! proposes for 8 bits.

#![allow(clippy::unwrap_used)]

use std::fs;
use std::io::BufReader;
use std::path::Path;
use std::sync::OnceLock;

pub const WIDTH: usize = 96;
pub const HEIGHT: usize = 72;
/// From the first to the last instant, us.
const LENGTH_US: i64 = 300_000;
const PERIOD_US: i64 = 20_000;
pub const EXPOSURE_US: i64 = 10_000;
const OPEN_US: i64 = 2_000;
const THRESHOLD: f64 = 0.25;
/// Steps in which light is followed, us.
const STEP_US: i64 = 500;

/// An event.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Event {
    pub t_us: i64,
    pub x: u16,
    pub y: u16,
    pub is_on: bool,
}

/// Frames: start of each exposure, 8-bit values row by row.
#[derive(Clone)]
pub struct Frames {
    pub starts_us: Vec<i64>,
    pub pictures: Vec<Vec<u8>>,
}

/// The recording.
pub struct Disc {
    /// In order of time.
    pub events: Vec<Event>,
    pub frames: Frames,
}

/// Light of every pixel at an instant, 8-bit values as an sRGB picture has them.
pub fn light(t_s: f64) -> Vec<f64> {
    let (width, height) = (WIDTH as f64, HEIGHT as f64);
    let centre = (
        (0.15 * width + 400.0 * t_s).rem_euclid(1.2 * width) - 0.1 * width,
        0.5 * height + 0.2 * height * libm::sin(6.0 * t_s),
    );
    let at = |i: usize| {
        let (x, y) = ((i % WIDTH) as f64, (i / WIDTH) as f64);
        let ground = 40.0 + 60.0 * (x / width) + 30.0 * libm::sin(y / 5.0);
        let inside = 1.0 / (1.0 + libm::exp((libm::hypot(x - centre.0, y - centre.1) - 0.16 * height) / 0.8));
        ground * (1.0 - inside) + 200.0 * inside
    };
    (0..WIDTH * HEIGHT).map(at).collect()
}

impl Disc {
    /// The recording, made once.
    pub fn get() -> &'static Disc {
        static DISC: OnceLock<Disc> = OnceLock::new();
        DISC.get_or_init(|| Disc { events: events(), frames: frames() })
    }

    /// Scene time of the first event, s: the zero of a run.
    pub fn zero_s(&self) -> f64 {
        self.events[0].t_us as f64 * 1e-6
    }
}

fn events() -> Vec<Event> {
    let log = |t_us: i64| light(t_us as f64 * 1e-6).into_iter().map(libm::log1p).collect::<Vec<f64>>();
    let mut reference = log(0);
    let mut before = reference.clone();
    let mut all: Vec<(f64, usize, bool)> = Vec::new();
    for step in 1..=LENGTH_US / STEP_US {
        let now = log(step * STEP_US);
        for pixel in 0..now.len() {
            while (now[pixel] - reference[pixel]).abs() >= THRESHOLD {
                let is_on = now[pixel] > reference[pixel];
                let level = reference[pixel] + if is_on { THRESHOLD } else { -THRESHOLD };
                let part = ((level - before[pixel]) / (now[pixel] - before[pixel] + 1e-12)).clamp(0.0, 1.0);
                all.push((((step - 1) as f64 + part) * STEP_US as f64, pixel, is_on));
                reference[pixel] = level;
            }
        }
        before = now;
    }
    all.sort_by(|a, b| a.0.total_cmp(&b.0));
    all.into_iter()
        .map(|(t, pixel, is_on)| Event {
            t_us: t.round() as i64,
            x: (pixel % WIDTH) as u16,
            y: (pixel / WIDTH) as u16,
            is_on,
        })
        .collect()
}

fn frames() -> Frames {
    let starts_us: Vec<i64> =
        (0..).map(|l| OPEN_US + l * PERIOD_US).take_while(|start| *start < LENGTH_US - EXPOSURE_US).collect();
    let mean = |start: &i64| {
        const PARTS: usize = 20;
        let mut sum = vec![0.0; WIDTH * HEIGHT];
        for part in 0..PARTS {
            let t = (*start as f64 + EXPOSURE_US as f64 * (part as f64 + 0.5) / PARTS as f64) * 1e-6;
            sum.iter_mut().zip(light(t)).for_each(|(sum, light)| *sum += light / PARTS as f64);
        }
        sum.into_iter().map(|mean| mean.round().clamp(0.0, 255.0) as u8).collect()
    };
    let pictures = starts_us.iter().map(mean).collect();
    Frames { starts_us, pictures }
}

/// An npy array of whole numbers.
pub fn npy<T: Copy>(kind: &str, values: &[T], bytes: impl Fn(T) -> Vec<u8>) -> Vec<u8> {
    let head = format!("{{'descr': '{kind}', 'fortran_order': False, 'shape': ({},), }}", values.len());
    let padded = format!("{head:<117}\n");
    b"\x93NUMPY\x01\x00\x76\x00"
        .iter()
        .copied()
        .chain(padded.bytes())
        .chain(values.iter().flat_map(|value| bytes(*value)))
        .collect()
}

/// A zip archive of members that are stored as they are.
pub fn zip(members: &[(&str, Vec<u8>)]) -> Vec<u8> {
    let (mut out, mut directory) = (Vec::new(), Vec::new());
    for (name, bytes) in members {
        let mut crc = flate2::Crc::new();
        crc.update(bytes);
        let size = (bytes.len() as u32).to_le_bytes();
        let common = [
            &[20, 0, 0, 0, 0, 0, 0, 0, 0, 0][..],
            &crc.sum().to_le_bytes(),
            &size,
            &size,
            &(name.len() as u16).to_le_bytes(),
            &[0, 0],
        ]
        .concat();
        let at = (out.len() as u32).to_le_bytes();
        directory.extend([&b"PK\x01\x02\x14\x00"[..], &common, &[0; 10], &at, name.as_bytes()].concat());
        out.extend([&b"PK\x03\x04"[..], &common, name.as_bytes(), bytes].concat());
    }
    let (count, start) = ((members.len() as u16).to_le_bytes(), (out.len() as u32).to_le_bytes());
    let size = (directory.len() as u32).to_le_bytes();
    out.extend(directory);
    out.extend([&b"PK\x05\x06\0\0\0\0"[..], &count, &count, &size, &start, &[0, 0]].concat());
    out
}

/// Events as an npz archive of t, x, y, p; the unit of t is in nobody's file.
pub fn npz(path: &Path, events: &[Event]) {
    let polarity: Vec<u8> = events.iter().map(|event| u8::from(event.is_on)).collect();
    npz_with(path, events, &polarity);
}

/// The same with a column of polarity of its own.
pub fn npz_with(path: &Path, events: &[Event], polarity: &[u8]) {
    let wide = |of: fn(&Event) -> i64| {
        npy("<i8", &events.iter().map(of).collect::<Vec<_>>(), |value: i64| value.to_le_bytes().to_vec())
    };
    let short = |of: fn(&Event) -> u16| {
        npy("<u2", &events.iter().map(of).collect::<Vec<_>>(), |value: u16| value.to_le_bytes().to_vec())
    };
    let members = [
        ("t.npy", wide(|event| event.t_us)),
        ("x.npy", short(|event| event.x)),
        ("y.npy", short(|event| event.y)),
        ("p.npy", npy("|u1", polarity, |value: u8| vec![value])),
    ];
    fs::write(path, zip(&members)).unwrap();
}

/// Pictures of any whole multiple of the array as 000000.png and so on, in place of those that are there.
pub fn write_pictures(folder: &Path, pictures: &[Vec<u8>]) {
    fs::create_dir_all(folder).unwrap();
    for (l, values) in pictures.iter().enumerate() {
        let times = (values.len() / (WIDTH * HEIGHT)).isqrt();
        let file = fs::File::create(folder.join(format!("{l:06}.png"))).unwrap();
        let mut encoder = png::Encoder::new(file, (WIDTH * times) as u32, (HEIGHT * times) as u32);
        encoder.set_color(png::ColorType::Grayscale);
        encoder.set_depth(png::BitDepth::Eight);
        encoder.write_header().unwrap().write_image_data(values).unwrap();
    }
}

/// A line each.
pub fn write_stamps(path: &Path, lines: impl Iterator<Item = String>) {
    fs::write(path, lines.map(|line| line + "\n").collect::<String>()).unwrap();
}

/// The linear value of an sRGB one, both of 0 to 1 (IEC 61966-2-1).
fn linear(value: f64) -> f64 {
    if value <= 0.04045 { value / 12.92 } else { libm::pow((value + 0.055) / 1.055, 2.4) }
}

/// PSNR of every fifth rendered frame against the light, dB, with a peak of 255; rows 20 to 65. `zero_s` is
/// the scene's time at the run's zero.
pub fn score(folder: &Path, zero_s: f64) -> f64 {
    let table = fs::read_to_string(folder.join("frames.csv")).unwrap();
    let lines: Vec<&str> = table.lines().filter(|line| !line.starts_with('#')).collect();
    let names: Vec<&str> = lines[0].split(',').collect();
    let comment = table.lines().next().unwrap();
    let number = |key: &str| {
        comment
            .split(key)
            .nth(1)
            .and_then(|rest| rest.split(';').next())
            .and_then(|text| text.trim().parse::<f64>().ok())
    };
    let column = |name: &str| names.iter().position(|known| *known == name);
    let (mut square, mut count) = (0.0, 0.0);
    for line in lines[1..].iter().step_by(5) {
        let cells: Vec<&str> = line.split(',').collect();
        let cell = |name: &str| column(name).map(|at| cells[at]);
        let value = |name: &str, key: &str| {
            cell(name).map_or_else(|| number(key).unwrap_or(0.0), |text| text.parse().unwrap())
        };
        let (scale, offset) = (value("scale_dn", "scale="), value("offset_dn", "offset="));
        let t_s = cell("t_mid_ns").unwrap().parse::<i64>().unwrap() as f64 * 1e-9 + zero_s;
        let truth = light(t_s);
        let mut reader =
            png::Decoder::new(BufReader::new(fs::File::open(folder.join(cell("file").unwrap())).unwrap()))
                .read_info()
                .unwrap();
        let mut bytes = vec![0; reader.output_buffer_size().unwrap()];
        let info = reader.next_frame(&mut bytes).unwrap();
        let channels = info.color_type.samples();
        let stored: Vec<f64> =
            bytes.chunks_exact(2).map(|pair| f64::from(u16::from_be_bytes([pair[0], pair[1]]))).collect();
        let times = info.width as usize / WIDTH;
        let row = |pixel: usize, down: usize| {
            ((pixel / WIDTH * times + down) * WIDTH + pixel % WIDTH) * times * channels
        };
        let sum = |pixel: usize| {
            (0..times)
                .map(|down| stored[row(pixel, down)..][..times * channels].iter().sum::<f64>())
                .sum::<f64>()
        };
        let grey = |pixel: usize| sum(pixel) / (times * times * channels) as f64;
        for pixel in 20 * WIDTH..66 * WIDTH {
            let error = grey(pixel) * scale + offset - 255.0 * linear(truth[pixel] / 255.0);
            square += error * error;
            count += 1.0;
        }
    }
    10.0 * libm::log10(255.0 * 255.0 * count / square)
}

/// A picture as PNG with 8 bits: grey, or red, green and blue.
pub fn png(width: usize, height: usize, codes: &[u8]) -> Vec<u8> {
    let mut bytes = Vec::new();
    let mut encoder = png::Encoder::new(&mut bytes, width as u32, height as u32);
    let is_grey = codes.len() == width * height;
    encoder.set_color(if is_grey { png::ColorType::Grayscale } else { png::ColorType::Rgb });
    encoder.set_depth(png::BitDepth::Eight);
    encoder.write_header().unwrap().write_image_data(codes).unwrap();
    bytes
}

/// An event of HS-ERGB: us, its place in 32nds of a pixel, ON.
pub type Placed = (i64, i64, i64, bool);

/// Writes a folder as HS-ERGB lays sequences out: pictures of a size with their stamps in us, and the events.
pub fn hs_ergb(folder: &Path, (width, height): (usize, usize), frames: &[(i64, Vec<u8>)], events: &[Placed]) {
    for name in ["images", "events"] {
        std::fs::create_dir_all(folder.join(name)).unwrap();
    }
    let mut stamps = String::new();
    for (l, (t, codes)) in frames.iter().enumerate() {
        std::fs::write(folder.join(format!("images/{l:06}.png")), png(width, height, codes)).unwrap();
        stamps += &format!("{t}\n");
        // File n lies between pictures n and n + 1; what comes before the first picture stands in the first.
        let from = if l == 0 { i64::MIN } else { *t };
        let to = frames.get(l + 1).map_or(i64::MAX, |(next, _)| *next);
        let part: Vec<&Placed> = events.iter().filter(|event| (from..to).contains(&event.0)).collect();
        let column = |of: &dyn Fn(&Placed) -> i64| {
            let values: Vec<i64> = part.iter().map(|event| of(event)).collect();
            npy("<i8", &values, |value| value.to_le_bytes().to_vec())
        };
        let bytes = zip(&[
            ("x.npy", column(&|event| event.1)),
            ("y.npy", column(&|event| event.2)),
            ("t.npy", column(&|event| event.0)),
            ("p.npy", column(&|event| i64::from(event.3))),
        ]);
        std::fs::write(folder.join(format!("events/{l:06}.npz")), bytes).unwrap();
    }
    std::fs::write(folder.join("images/timestamp.txt"), stamps).unwrap();
}
