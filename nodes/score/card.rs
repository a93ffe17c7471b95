//! Metric cards: what has to be said with a number, so that it can be compared with another one.
//!
//! Figures of one name differ between papers because channel, value range, crop, weights and matching of
//! frames are not stated. Every scorer fills in a [`Card`]; no field can be forgotten, and the text has one
//! form: `definition: key = text; key = text`, keys in one order.

use photocurrent_core::{Colour, FramesMeta};

/// How numbers were measured.
#[derive(Clone, Debug, PartialEq)]
pub struct Card {
    /// Metric and version of its definition: `psnr.v1`. The version rises when the number for the same
    /// pictures changes.
    pub definition: &'static str,
    /// Which channel, in which encoding.
    pub channel: String,
    /// The range of values that the definition is about.
    pub range: String,
    /// What is left out at the border.
    pub border: String,
    /// Which frames are compared with which.
    pub frames: String,
    /// Which pixels count.
    pub region: String,
    /// Digest of the weights of a network.
    pub weights: Option<String>,
    /// What calculates.
    pub backend: String,
    /// How frames become one number.
    pub pooled: String,
    /// What else the numbers depend on.
    pub more: Vec<(&'static str, String)>,
}

/// For a metric that is calculated here.
pub const OWN: &str = "own, f64";

/// For a metric whose pooled value is the mean.
pub const MEAN: &str = "mean over frames";

impl From<Card> for String {
    fn from(card: Card) -> String {
        let fields = [
            ("channel", card.channel),
            ("range", card.range),
            ("border", card.border),
            ("frames", card.frames),
            ("region", card.region),
            ("weights", card.weights.unwrap_or_else(|| "none".into())),
            ("backend", card.backend),
            ("pooled", card.pooled),
        ];
        // A semicolon ends a field.
        let field = |(name, text): (&str, String)| format!("{name} = {}", text.replace(';', ","));
        let fields: Vec<String> = fields.into_iter().chain(card.more).map(field).collect();
        format!("{}: {}", card.definition, fields.join("; "))
    }
}

/// The channel field for values that are used as they are, all channels together.
pub fn linear_dn(meta: &FramesMeta) -> String {
    match meta.colour {
        Colour::Mono => "linear DN, 1 channel".into(),
        Colour::Rgb => "linear DN, 3 channels together".into(),
        mosaic => format!("linear DN, {mosaic} mosaic"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_card_can_be_read_by_a_program() {
        let card = Card {
            definition: "test.v1",
            channel: "grey".into(),
            range: "0 to 1; above black".into(),
            border: "none".into(),
            frames: "all".into(),
            region: "all".into(),
            weights: None,
            backend: OWN.into(),
            pooled: MEAN.into(),
            more: vec![("ceiling", "120 dB".into())],
        };
        let text = String::from(card);
        let (definition, fields) = text.split_once(": ").unwrap();
        let fields: Vec<(&str, &str)> =
            fields.split("; ").map(|field| field.split_once(" = ").unwrap()).collect();
        assert_eq!(definition, "test.v1");
        assert_eq!(
            fields.iter().map(|(key, _)| *key).collect::<Vec<_>>(),
            ["channel", "range", "border", "frames", "region", "weights", "backend", "pooled", "ceiling"]
        );
        assert_eq!((fields[1].1, fields[5].1), ("0 to 1, above black", "none"));
    }
}
