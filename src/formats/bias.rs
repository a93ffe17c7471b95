//! Settings of Prophesee sensors: `.bias` files and the JSON of camera settings.
//!
//! A `.bias` file has lines `value % name`, with lines of `% comment` between; new software writes JSON with
//! the list `ll_biases_state.bias`. The values set the sensor's current sources and comparators, in units of
//! its own that differ between generations: no threshold in log units follows from them without a
//! calibration, so none is computed here. They are facts for people, and for those who have measured their
//! sensor.

use crate::error::FormatError;
use serde_json::Value;
use std::io::Read;
use std::path::Path;

/// No file of settings is larger.
const LARGEST: u64 = 1 << 20;

/// Names and values, in the file's order.
pub type Biases = Vec<(String, i64)>;

/// Reads a `.bias` file or a JSON of camera settings; which of them it is shows from its first letter.
///
/// # Errors
/// When the file cannot be read, has a line of another form, or has no bias at all.
pub fn read(path: &Path) -> Result<Biases, FormatError> {
    let mut text = String::new();
    let io = |error: std::io::Error| FormatError::io(path, &error);
    let file = std::fs::File::open(path).map_err(io)?;
    file.take(LARGEST + 1).read_to_string(&mut text).map_err(io)?;
    if text.len() as u64 > LARGEST {
        return Err(FormatError::new(
            path,
            "more than a megabyte",
            "name a .bias file or a JSON of camera settings",
        ));
    }
    parse(path, &text)
}

/// Reads the text of a file; `path` is for messages.
///
/// # Errors
/// As [`read`].
pub fn parse(path: &Path, text: &str) -> Result<Biases, FormatError> {
    let biases =
        if text.trim_start().starts_with('{') { parse_json(path, text)? } else { parse_lines(path, text)? };
    if biases.is_empty() {
        return Err(FormatError::new(path, "no bias", "name a .bias file or a JSON of camera settings")
            .expected("lines such as `300 % bias_diff`"));
    }
    Ok(biases)
}

fn parse_lines(path: &Path, text: &str) -> Result<Biases, FormatError> {
    let mut biases = Biases::new();
    for (at, line) in text
        .lines()
        .enumerate()
        .filter(|(_, line)| !line.trim().is_empty() && !line.trim_start().starts_with(['%', '#']))
    {
        let mut parts = line.split('%').map(str::trim);
        let value = parts.next().and_then(number);
        // What comes after a second `%` is a remark of the maker's.
        let name = parts.next().filter(|name| !name.is_empty() && !name.contains(char::is_whitespace));
        let (Some(value), Some(name)) = (value, name) else {
            let found: String = line.chars().take(80).collect();
            let error = FormatError::new(
                path,
                format!("`{found}`"),
                "remove the line, or write it as the camera's software does",
            );
            return Err(error.at(format!("line {}", at + 1)).expected("`value % name`"));
        };
        biases.push((name.into(), value));
    }
    Ok(biases)
}

/// Decimal, or hexadecimal after `0x`.
fn number(text: &str) -> Option<i64> {
    match text.strip_prefix("0x").or(text.strip_prefix("0X")) {
        Some(digits) => i64::from_str_radix(digits, 16).ok(),
        None => text.parse().ok(),
    }
}

fn parse_json(path: &Path, text: &str) -> Result<Biases, FormatError> {
    let wrong = |found: String| {
        FormatError::new(path, found, "save the camera's settings again")
            .expected("`ll_biases_state.bias`, a list of `name` and `value`")
    };
    let settings: Value = serde_json::from_str(text)
        .map_err(|error| wrong(format!("no JSON: {error}")).at(format!("line {}", error.line())))?;
    let list = settings
        .pointer("/ll_biases_state/bias")
        .and_then(Value::as_array)
        .ok_or_else(|| wrong("JSON without such a list".into()))?;
    let of = |bias: &Value| Some((bias.get("name")?.as_str()?.to_owned(), bias.get("value")?.as_i64()?));
    list.iter()
        .enumerate()
        .map(|(n, bias)| of(bias).ok_or_else(|| wrong(format!("`{bias}`")).at(format!("bias {n}"))))
        .collect()
}

/// The settings that stand next to a recording under its name, as the camera's software leaves them; as a
/// fact for people. A file that is none is passed over: it is not part of the recording.
pub(crate) fn next_to(recording: &Path) -> Option<(String, String)> {
    let biases = read(&recording.with_extension("bias")).ok()?;
    let list: Vec<String> = biases.iter().map(|(name, value)| format!("{name} {value}")).collect();
    Some((
        "biases".into(),
        format!("{} (settings in the sensor's own units; thresholds need a calibration)", list.join(", ")),
    ))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn of(text: &str) -> Result<Biases, String> {
        parse(Path::new("a.bias"), text).map_err(|error| error.to_string())
    }

    #[test]
    fn lines_and_json_give_the_same_names_and_values() {
        let lines = "% gen 3.1 CD standard biases\n300   % bias_diff           %   v\n-5\t% bias_fo\n0x10 % \
                     bias_hpf\n\n";
        let expected = vec![("bias_diff".to_owned(), 300), ("bias_fo".into(), -5), ("bias_hpf".into(), 16)];
        assert_eq!(of(lines), Ok(expected.clone()));
        let json = r#"{"ll_biases_state": {"bias": [
            {"name": "bias_diff", "value": 300}, {"name": "bias_fo", "value": -5},
            {"name": "bias_hpf", "value": 16}
        ]}}"#;
        assert_eq!(of(json), Ok(expected));
    }

    #[test]
    fn a_line_of_another_form_is_named() {
        let error = of("300 % bias_diff\nbias_fo = 3\n").expect_err("no such line");
        assert!(error.contains("line 2") && error.contains("bias_fo = 3"), "{error}");
        assert!(of("% only a comment\n").is_err());
        assert!(of("{\"ll_biases_state\": {}}").is_err());
        assert!(of("{").is_err());
    }
}
