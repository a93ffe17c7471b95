//! The name of a content: a BLAKE3 hash over framed fields.
//!
//! Each field is preceded by its length, so that no two different sequences of fields hash alike. Numbers are
//! little-endian. The bytes of an HDF5 file never enter: two libraries may store one content differently.

use serde::{Deserialize, Serialize};
use std::fmt;
use std::str::FromStr;

/// 256 bits that stand for a content. Prints as 64 hexadecimal digits.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Digest([u8; 32]);

impl Digest {
    /// Of raw bytes, with no framing: for whole files.
    pub fn of_bytes(bytes: &[u8]) -> Digest {
        Digest(*blake3::hash(bytes).as_bytes())
    }

    /// The 32 bytes.
    pub fn as_bytes(&self) -> &[u8; 32] {
        &self.0
    }

    /// From the 32 bytes.
    pub fn from_bytes(bytes: [u8; 32]) -> Digest {
        Digest(bytes)
    }

    /// The first ten digits: enough to distinguish artefacts on a terminal.
    pub fn short(&self) -> String {
        self.to_string()[..10].to_string()
    }
}

impl fmt::Display for Digest {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.0.iter().try_for_each(|byte| write!(f, "{byte:02x}"))
    }
}

impl fmt::Debug for Digest {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "Digest({})", self.short())
    }
}

/// The text was not 64 hexadecimal digits.
#[derive(Debug, thiserror::Error)]
#[error("a digest is 64 hexadecimal digits, found `{0}`")]
pub struct NotADigest(String);

impl FromStr for Digest {
    type Err = NotADigest;
    fn from_str(text: &str) -> Result<Digest, NotADigest> {
        let bad = || NotADigest(text.chars().take(80).collect());
        if text.len() != 64 || !text.is_ascii() {
            return Err(bad());
        }
        let mut bytes = [0; 32];
        for (i, byte) in bytes.iter_mut().enumerate() {
            *byte = u8::from_str_radix(&text[2 * i..2 * i + 2], 16).map_err(|_| bad())?;
        }
        Ok(Digest(bytes))
    }
}

impl Serialize for Digest {
    fn serialize<S: serde::Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.collect_str(self)
    }
}

impl<'de> Deserialize<'de> for Digest {
    fn deserialize<D: serde::Deserializer<'de>>(deserializer: D) -> Result<Digest, D::Error> {
        let text = String::deserialize(deserializer)?;
        text.parse().map_err(serde::de::Error::custom)
    }
}

/// Hashes one framed field after another.
pub struct DigestBuilder(blake3::Hasher);

impl DigestBuilder {
    /// Begins with a name that says what is hashed and in which version, `"photocurrent-key/1"`.
    pub fn new(domain: &str) -> DigestBuilder {
        let mut builder = DigestBuilder(blake3::Hasher::new());
        builder.text(domain);
        builder
    }

    fn framed(&mut self, bytes: &[u8]) -> &mut Self {
        self.0.update(&(bytes.len() as u64).to_le_bytes());
        self.0.update(bytes);
        self
    }

    /// A text.
    pub fn text(&mut self, text: &str) -> &mut Self {
        self.framed(text.as_bytes())
    }

    /// An integer.
    pub fn integer(&mut self, value: i64) -> &mut Self {
        self.framed(&value.to_le_bytes())
    }

    /// Another digest.
    pub fn digest(&mut self, digest: &Digest) -> &mut Self {
        self.framed(&digest.0)
    }

    /// A slice of plain numbers, as its little-endian bytes.
    pub fn slice<T: bytemuck::Pod>(&mut self, values: &[T]) -> &mut Self {
        // The tool is built for little-endian machines only; `LITTLE_ENDIAN` below makes that a compile error
        // elsewhere.
        const LITTLE_ENDIAN: () =
            assert!(cfg!(target_endian = "little"), "digests are defined over little-endian bytes");
        #[allow(clippy::let_unit_value)]
        let () = LITTLE_ENDIAN;
        self.framed(bytemuck::cast_slice(values))
    }

    /// The digest of everything so far.
    pub fn finish(&self) -> Digest {
        Digest(*self.0.finalize().as_bytes())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn fields_do_not_run_into_each_other() {
        let ab = DigestBuilder::new("t").text("ab").text("c").finish();
        let bc = DigestBuilder::new("t").text("a").text("bc").finish();
        assert_ne!(ab, bc);
    }

    #[test]
    fn whole_bytes_hash_as_blake3_publishes() {
        // The empty input's value is printed in the BLAKE3 test vectors.
        let published = "af1349b9f5f9a1a6a0404dea36dcc9499bcb25c9adc112b7cc9a93cae41f3262";
        assert_eq!(Digest::of_bytes(b"").to_string(), published);
        assert_eq!(published.parse::<Digest>().unwrap(), Digest::of_bytes(b""));
    }
}
