//! Text and pictures as they may stand in HTML.

use base64::Engine;
use base64::engine::general_purpose::STANDARD;

/// Text that cannot be taken for markup, in element content and in quoted attributes. Control characters but
/// for line ends become spaces.
///
/// ```
/// use photocurrent_page::escaped;
/// assert_eq!(escaped("<b a='1' b=\"2\">&\u{7}"), "&lt;b a=&#39;1&#39; b=&quot;2&quot;&gt;&amp; ");
/// ```
pub fn escaped(text: &str) -> String {
    let mut html = String::with_capacity(text.len());
    for c in text.chars() {
        match c {
            '&' => html.push_str("&amp;"),
            '<' => html.push_str("&lt;"),
            '>' => html.push_str("&gt;"),
            '"' => html.push_str("&quot;"),
            '\'' => html.push_str("&#39;"),
            '\n' => html.push('\n'),
            c if c.is_control() => html.push(' '),
            c => html.push(c),
        }
    }
    html
}

/// The bytes of a PNG file as an address that an `img` takes.
///
/// ```
/// assert_eq!(photocurrent_page::png_uri(b"\x89PNG"), "data:image/png;base64,iVBORw==");
/// ```
pub fn png_uri(png: &[u8]) -> String {
    format!("data:image/png;base64,{}", STANDARD.encode(png))
}

/// Bytes as text for JSON, base64.
pub(crate) fn as_text<S: serde::Serializer>(bytes: &[u8], to: S) -> Result<S::Ok, S::Error> {
    to.serialize_str(&STANDARD.encode(bytes))
}

/// Escaped text in which what stands in backquotes is code.
pub(crate) fn code_spans(text: &str) -> String {
    let parts = text.split('`').enumerate();
    parts
        .map(|(at, part)| if at % 2 == 1 { format!("<code>{}</code>", escaped(part)) } else { escaped(part) })
        .collect()
}

/// Names and texts as a list of terms; nothing for none.
pub(crate) fn list(rows: &[(String, String)]) -> String {
    if rows.is_empty() {
        return String::new();
    }
    let rows: String = rows
        .iter()
        .map(|(name, text)| format!("<dt>{}</dt><dd>{}</dd>\n", escaped(name), escaped(text)))
        .collect();
    format!("<dl>\n{rows}</dl>\n")
}

/// What is missing or was left out, a paragraph each.
pub(crate) fn notes(texts: &[String]) -> String {
    texts.iter().map(|text| format!("<p class=\"missing\">{}</p>\n", code_spans(text))).collect()
}

/// JSON inside a `script` element: nothing in it ends the element or begins a comment.
pub(crate) fn embedded(json: &serde_json::Value) -> String {
    json.to_string().replace('<', "\\u003c").replace('\u{2028}', "\\u2028").replace('\u{2029}', "\\u2029")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn embedded_text_cannot_end_the_script_it_stands_in() {
        let json = serde_json::json!({ "label": "</script><script>alert(1)</script><!--" });
        let html = embedded(&json);
        assert!(!html.contains('<'), "{html}");
        assert_eq!(serde_json::from_str::<serde_json::Value>(&html).unwrap(), json);
    }
}
