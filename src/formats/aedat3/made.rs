//! A few bytes of AEDAT 3.1 by hand, for tests: packets laid out after the published format.

/// The comment lines of a file with one source, numbered 1.
pub fn header(camera: &str) -> Vec<u8> {
    format!(
        "#!AER-DAT3.1\r\n#Format: RAW\r\n#Source 1: {camera}\r\n#Start-Time: 2017-03-01 12:00:00 \
             (TZ+0100)\r\n#!END-HEADER\r\n"
    )
    .into_bytes()
}

/// A packet of events of `size` bytes each.
pub fn packet(kind: u16, source: u16, size: u32, overflow: u32, events: &[Vec<u8>]) -> Vec<u8> {
    let valid = events.iter().filter(|event| event.first().is_some_and(|byte| byte & 1 == 1)).count() as u32;
    let count = events.len() as u32;
    let mut bytes = [kind.to_le_bytes(), source.to_le_bytes()].concat();
    [size, 4, overflow, count, count, valid].iter().for_each(|number| bytes.extend(number.to_le_bytes()));
    events.iter().for_each(|event| bytes.extend(event));
    bytes
}

/// Polarity events: stamp in us (of which 31 bits are stored), column, row, ON.
pub fn polarity(overflow: u32, events: &[(i64, u16, u16, bool)]) -> Vec<u8> {
    let event = |&(t, x, y, on): &(i64, u16, u16, bool)| {
        word(u32::from(x) << 17 | u32::from(y) << 2 | u32::from(on) << 1 | 1, t)
    };
    packet(1, 1, 8, overflow, &events.iter().map(event).collect::<Vec<_>>())
}

/// Special events: stamp in us, type.
pub fn special(overflow: u32, events: &[(i64, u32)]) -> Vec<u8> {
    packet(0, 1, 8, overflow, &events.iter().map(|&(t, kind)| word(kind << 1 | 1, t)).collect::<Vec<_>>())
}

fn word(data: u32, t: i64) -> Vec<u8> {
    [data.to_le_bytes(), ((t & 0x7fff_ffff) as u32).to_le_bytes()].concat()
}

/// One frame in a packet: channels, colour filter, exposure in us, size, values as the 16 bits that are
/// stored.
pub fn frame(
    overflow: u32,
    (channels, filter): (u32, u32),
    exposure: (i64, i64),
    size: (u32, u32),
    values: &[u16],
) -> Vec<u8> {
    let mut bytes = (filter << 4 | channels << 1 | 1).to_le_bytes().to_vec();
    let stamps =
        [exposure.0 - 10, exposure.1 + 500, exposure.0, exposure.1].map(|t| (t & 0x7fff_ffff) as u32);
    stamps.iter().chain([size.0, size.1, 0, 0].iter()).for_each(|number| bytes.extend(number.to_le_bytes()));
    values.iter().for_each(|value| bytes.extend(value.to_le_bytes()));
    packet(2, 1, bytes.len() as u32, overflow, &[bytes])
}
