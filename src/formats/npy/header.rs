//! The header of an npy array: a Python dictionary that names type, order and shape.
//!
//! Nothing is taken from it on trust: it is at most 64 KiB long, its numbers are checked before they are
//! multiplied, and whoever reads the array compares its size with the file's.

use std::io::{Read, Result as IoResult};

/// Longest header that is read; numpy's own limit is 10,000 bytes for a trusted one.
const LONGEST: usize = 1 << 16;

/// What kind of number.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Kind {
    Bool,
    Int,
    Uint,
    Float,
    /// Bytes without a meaning: padding.
    Void,
}

/// A number in bytes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Scalar {
    pub(crate) kind: Kind,
    pub(crate) bytes: usize,
    pub(crate) big_endian: bool,
}

impl Scalar {
    /// For people: "u16", "f64, big-endian".
    pub(crate) fn name(self) -> String {
        let letter = match self.kind {
            Kind::Bool => return "bool".into(),
            Kind::Int => "i",
            Kind::Uint => "u",
            Kind::Float => "f",
            Kind::Void => "V",
        };
        format!(
            "{letter}{}{}",
            self.bytes * 8,
            if self.big_endian && self.bytes > 1 { ", big-endian" } else { "" }
        )
    }
}

/// A field of a record: name, type, byte in the record.
pub(crate) type Field = (String, Scalar, usize);

/// What one element is.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) enum Element {
    /// A number.
    Number(Scalar),
    /// A record of so many bytes.
    Record(Vec<Field>, usize),
}

impl Element {
    /// Bytes of one element.
    pub(crate) fn bytes(&self) -> usize {
        match self {
            Element::Number(scalar) => scalar.bytes,
            Element::Record(_, bytes) => *bytes,
        }
    }
}

/// A header.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Header {
    pub(crate) element: Element,
    pub(crate) fortran: bool,
    pub(crate) shape: Vec<u64>,
    /// Bytes before the first element.
    pub(crate) start: u64,
}

impl Header {
    /// Number of elements, when it fits.
    pub(crate) fn elements(&self) -> Option<u64> {
        self.shape.iter().try_fold(1_u64, |product, side| product.checked_mul(*side))
    }
}

/// Reads a header; the inner `Err` says what is wrong with it.
pub(crate) fn read(from: &mut impl Read) -> IoResult<Result<Header, String>> {
    let mut begin = [0; 8];
    if !fill(from, &mut begin)? || &begin[..6] != b"\x93NUMPY" {
        return Ok(Err("it does not begin as a numpy array does".into()));
    }
    let wide = match begin[6] {
        1 => 2,
        2 | 3 => 4,
        version => return Ok(Err(format!("version {version} of the npy format is unknown"))),
    };
    let mut length = [0; 4];
    if !fill(from, &mut length[..wide])? {
        return Ok(Err("it ends inside its header".into()));
    }
    let length = u32::from_le_bytes(length) as usize;
    if length > LONGEST {
        return Ok(Err(format!("its header claims {length} bytes; {LONGEST} are plausible")));
    }
    let mut text = vec![0; length];
    if !fill(from, &mut text)? {
        return Ok(Err("it ends inside its header".into()));
    }
    Ok(parse(&text, (8 + wide + length) as u64))
}

/// Fills `buffer`; false when the data end before.
fn fill(from: &mut impl Read, buffer: &mut [u8]) -> IoResult<bool> {
    match from.read_exact(buffer) {
        Ok(()) => Ok(true),
        Err(error) if error.kind() == std::io::ErrorKind::UnexpectedEof => Ok(false),
        Err(error) => Err(error),
    }
}

/// A piece of a Python literal.
#[derive(Clone, Debug, PartialEq)]
enum Literal {
    Text(String),
    Whole(u64),
    Bool(bool),
    /// A tuple or a list.
    Several(Vec<Literal>),
    Dictionary(Vec<(String, Literal)>),
}

struct Parser<'a> {
    rest: &'a [u8],
}

impl Parser<'_> {
    fn skip(&mut self) {
        self.rest = self.rest.trim_ascii_start();
    }

    fn eat(&mut self, byte: u8) -> bool {
        self.skip();
        let found = self.rest.first() == Some(&byte);
        if found {
            self.rest = &self.rest[1..];
        }
        found
    }

    /// A literal, nested `depth` deep at most.
    fn literal(&mut self, depth: u32) -> Option<Literal> {
        self.skip();
        match *self.rest.first()? {
            quote @ (b'\'' | b'"') => {
                let text = &self.rest[1..];
                let end = text.iter().position(|&byte| byte == quote)?;
                self.rest = &text[end + 1..];
                Some(Literal::Text(String::from_utf8_lossy(&text[..end]).into_owned()))
            }
            b'0'..=b'9' => {
                let end = self.rest.iter().position(|byte| !byte.is_ascii_digit()).unwrap_or(self.rest.len());
                let whole = std::str::from_utf8(&self.rest[..end]).ok()?.parse().ok()?;
                self.rest = &self.rest[end..];
                // Python 2 wrote 100L.
                self.eat(b'L');
                Some(Literal::Whole(whole))
            }
            b'T' => self.word(b"True", true),
            b'F' => self.word(b"False", false),
            b'(' => self.several(b'(', b')', depth),
            b'[' => self.several(b'[', b']', depth),
            b'{' if depth > 0 => {
                self.eat(b'{');
                let mut pairs = Vec::new();
                while !self.eat(b'}') {
                    let Literal::Text(key) = self.literal(0)? else { return None };
                    if !self.eat(b':') {
                        return None;
                    }
                    pairs.push((key, self.literal(depth - 1)?));
                    if !self.eat(b',') {
                        return self.eat(b'}').then_some(Literal::Dictionary(pairs));
                    }
                }
                Some(Literal::Dictionary(pairs))
            }
            _ => None,
        }
    }

    fn word(&mut self, word: &[u8], value: bool) -> Option<Literal> {
        self.rest = self.rest.strip_prefix(word)?;
        Some(Literal::Bool(value))
    }

    fn several(&mut self, open: u8, close: u8, depth: u32) -> Option<Literal> {
        if depth == 0 || !self.eat(open) {
            return None;
        }
        let mut all = Vec::new();
        while !self.eat(close) {
            all.push(self.literal(depth - 1)?);
            if !self.eat(b',') {
                return self.eat(close).then_some(Literal::Several(all));
            }
        }
        Some(Literal::Several(all))
    }
}

fn parse(text: &[u8], start: u64) -> Result<Header, String> {
    let shown = || String::from_utf8_lossy(&text[..text.len().min(120)]).trim().escape_debug().to_string();
    let Some(Literal::Dictionary(pairs)) = Parser { rest: text }.literal(6) else {
        return Err(format!("its header is no dictionary: {}", shown()));
    };
    let get = |name: &str| pairs.iter().find(|(key, _)| key == name).map(|(_, value)| value);
    let element = element(get("descr").ok_or_else(|| format!("its header names no `descr`: {}", shown()))?)?;
    let Some(Literal::Bool(fortran)) = get("fortran_order") else {
        return Err(format!("its header has no `fortran_order`: {}", shown()));
    };
    let Some(Literal::Several(sides)) = get("shape") else {
        return Err(format!("its header has no `shape`: {}", shown()));
    };
    let shape: Option<Vec<u64>> =
        sides.iter().map(|side| if let Literal::Whole(side) = side { Some(*side) } else { None }).collect();
    let header = Header {
        element,
        fortran: *fortran,
        shape: shape.ok_or("its shape is not made of whole numbers")?,
        start,
    };
    header
        .elements()
        .and_then(|all| all.checked_mul(header.element.bytes() as u64))
        .ok_or("its shape claims more bytes than there are numbers for")?;
    Ok(header)
}

fn element(descr: &Literal) -> Result<Element, String> {
    match descr {
        Literal::Text(code) => match scalar(code)? {
            Scalar { kind: Kind::Void, .. } => Err(format!("elements of type `{code}` hold no numbers")),
            number => Ok(Element::Number(number)),
        },
        Literal::Several(fields) => {
            let mut read = Vec::new();
            let mut at = 0_usize;
            for field in fields {
                let Literal::Several(parts) = field else {
                    return Err("a field of its record is no tuple".into());
                };
                // A title may stand with the name: ('title', 'name').
                let name = match parts.first() {
                    Some(Literal::Several(both)) => both.get(1),
                    name => name,
                };
                let Some(Literal::Text(name)) = name else {
                    return Err("a field of its record has no name".into());
                };
                let name = name.clone();
                let Some(Literal::Text(code)) = parts.get(1) else {
                    return Err(format!("the field `{name}` of its record is a record itself"));
                };
                let number = scalar(code)?;
                let repeat = match parts.get(2) {
                    None => 1,
                    Some(Literal::Several(sides)) => sides
                        .iter()
                        .try_fold(1_usize, |all, side| {
                            if let Literal::Whole(side) = side {
                                all.checked_mul(usize::try_from(*side).ok()?)
                            } else {
                                None
                            }
                        })
                        .ok_or_else(|| format!("the field `{name}` of its record has no plausible shape"))?,
                    Some(_) => {
                        return Err(format!("the field `{name}` of its record has no plausible shape"));
                    }
                };
                if repeat == 1 && number.kind != Kind::Void {
                    read.push((name, number, at));
                }
                at = number
                    .bytes
                    .checked_mul(repeat)
                    .and_then(|bytes| at.checked_add(bytes))
                    .ok_or("its record is too large")?;
            }
            if at == 0 || at > 1 << 16 {
                return Err(format!("its record has {at} bytes"));
            }
            Ok(Element::Record(read, at))
        }
        _ => Err("its `descr` is neither a type nor a record".into()),
    }
}

/// `<u2`, `|b1`, `>f8`.
fn scalar(code: &str) -> Result<Scalar, String> {
    let bytes = code.as_bytes();
    let (big_endian, rest) = match bytes.first() {
        Some(b'<' | b'|' | b'=') => (false, &code[1..]),
        Some(b'>') => (true, &code[1..]),
        _ => (false, code),
    };
    let mut letters = rest.chars();
    let kind = match letters.next() {
        Some('b') => Kind::Bool,
        Some('?') => return Ok(Scalar { kind: Kind::Bool, bytes: 1, big_endian }),
        Some('i') => Kind::Int,
        Some('u') => Kind::Uint,
        Some('f') => Kind::Float,
        Some('V' | 'S' | 'U') => Kind::Void,
        Some('O') => {
            return Err("it holds pickled Python objects, which are programs and are not read; save \
                                 it again as plain numbers"
                .into());
        }
        _ => return Err(format!("elements of type `{}` are no real numbers", code.escape_debug())),
    };
    let size: usize =
        letters.as_str().parse().map_err(|_| format!("the type `{}` has no size", code.escape_debug()))?;
    let size = if rest.starts_with('U') { size.saturating_mul(4) } else { size };
    let fits = match kind {
        Kind::Bool => size == 1,
        Kind::Int | Kind::Uint => matches!(size, 1 | 2 | 4 | 8),
        Kind::Float => matches!(size, 4 | 8),
        Kind::Void => size <= 1 << 16,
    };
    if !fits {
        return Err(format!("numbers of type `{}` are not read", code.escape_debug()));
    }
    Ok(Scalar { kind, bytes: size, big_endian })
}

/// A stored number.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Number {
    Whole(i64),
    /// A u64 beyond i64.
    Beyond,
    Fraction(f64),
}

/// Hands every `stride`-th number from byte `at` on to `take`.
#[inline]
pub(crate) fn each(scalar: Scalar, rows: &[u8], stride: usize, at: usize, mut take: impl FnMut(Number)) {
    macro_rules! run {
        ($type:ty, $size:literal, $make:expr) => {{
            for row in rows.chunks_exact(stride) {
                let Some(Ok(bytes)) = row.get(at..at + $size).map(<[u8; $size]>::try_from) else { return };
                let value = if scalar.big_endian {
                    <$type>::from_be_bytes(bytes)
                } else {
                    <$type>::from_le_bytes(bytes)
                };
                take($make(value));
            }
        }};
    }
    match (scalar.kind, scalar.bytes) {
        (Kind::Bool, 1) => run!(u8, 1, |v| Number::Whole(i64::from(v != 0))),
        (Kind::Uint, 1) => run!(u8, 1, |v| Number::Whole(i64::from(v))),
        (Kind::Uint, 2) => run!(u16, 2, |v| Number::Whole(i64::from(v))),
        (Kind::Uint, 4) => run!(u32, 4, |v| Number::Whole(i64::from(v))),
        (Kind::Uint, 8) => run!(u64, 8, |v: u64| i64::try_from(v).map_or(Number::Beyond, Number::Whole)),
        (Kind::Int, 1) => run!(i8, 1, |v| Number::Whole(i64::from(v))),
        (Kind::Int, 2) => run!(i16, 2, |v| Number::Whole(i64::from(v))),
        (Kind::Int, 4) => run!(i32, 4, |v| Number::Whole(i64::from(v))),
        (Kind::Int, 8) => run!(i64, 8, Number::Whole),
        (Kind::Float, 4) => run!(f32, 4, |v| Number::Fraction(f64::from(v))),
        (Kind::Float, 8) => run!(f64, 8, Number::Fraction),
        _ => {}
    }
}
