//! The text at the head of RAW and DAT files: lines of `% key value`.
//!
//! New files end it with `% end`; in old ones the data begin with the first line that is none. What the file
//! does not say of its encoding and size may follow from the camera that it names, where that is certain.

use photocurrent_core::Extent;

/// No header is longer; none of the makers' comes near.
pub(crate) const LONGEST: usize = 1 << 16;

/// The header of a file.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub(crate) struct Header {
    /// Keys and values, as they stand.
    pub fields: Vec<(String, String)>,
    /// Where the data begin.
    pub data_at: usize,
}

/// How the data of a RAW file are encoded.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Encoding {
    Evt2,
    Evt21,
    Evt3,
}

impl Header {
    /// Reads the header at the head of a file; `None` where there is none.
    pub(super) fn parse(bytes: &[u8]) -> Option<Header> {
        let mut header = Header::default();
        let bytes = &bytes[..bytes.len().min(LONGEST)];
        loop {
            let rest = &bytes[header.data_at..];
            let Some(line) = line(rest) else { break };
            header.data_at += line.len() + 1;
            let text = line[1..].trim();
            if text == "end" {
                break;
            }
            let (key, value) = text.split_once([' ', '\t']).unwrap_or((text, ""));
            header.fields.push((key.into(), value.trim().into()));
        }
        (header.data_at > 0).then_some(header)
    }

    /// The value of a key, in whatever case it is written; the first if there are several, none if it is
    /// empty.
    pub(super) fn get(&self, key: &str) -> Option<&str> {
        let mut values =
            self.fields.iter().filter(|(k, _)| k.eq_ignore_ascii_case(key)).map(|(_, value)| value.as_str());
        values.find(|value| !value.is_empty())
    }

    /// An option of the `format` line: `EVT3;height=720;width=1280`.
    fn option(&self, name: &str) -> Option<&str> {
        let mut options = self.get("format")?.split(';').skip(1).filter_map(|option| option.split_once('='));
        options.find(|(key, _)| key.trim().eq_ignore_ascii_case(name)).map(|(_, value)| value.trim())
    }

    /// How the data are encoded; `None` where the file is no RAW file of ours.
    pub(super) fn encoding(&self) -> Option<Encoding> {
        if let Some(format) = self.get("format") {
            return match format.split(';').next().unwrap_or("").trim() {
                "EVT2" | "EVT2.0" => Some(Encoding::Evt2),
                "EVT21" | "EVT2.1" => Some(Encoding::Evt21),
                "EVT3" | "EVT3.0" => Some(Encoding::Evt3),
                _ => None,
            };
        }
        match self.get("evt")? {
            "2" | "2.0" => Some(Encoding::Evt2),
            "2.1" => Some(Encoding::Evt21),
            "3" | "3.0" => Some(Encoding::Evt3),
            _ => None,
        }
    }

    /// Are the halves of EVT2.1 words swapped? As the header says; where it does not, as the camera that it
    /// names is known to write.
    pub(super) fn is_legacy(&self) -> bool {
        /// The first of the maker's systems that writes whole words.
        const FIRST_WHOLE: u32 = 0x37;
        match self.option("endianness").or(self.get("endianness")) {
            Some(order) => order.eq_ignore_ascii_case("legacy"),
            None => {
                self.is_by_maker() && self.number("system_ID").is_some_and(|id| id > 0 && id < FIRST_WHOLE)
            }
        }
    }

    fn number(&self, key: &str) -> Option<u32> {
        self.get(key)?.parse().ok()
    }

    /// Is the camera of the maker's own? System numbers of others mean other things.
    fn is_by_maker(&self) -> bool {
        let names = ["camera_integrator_name", "plugin_integrator_name", "integrator_name"];
        names.iter().filter_map(|name| self.get(name)).all(|name| name.eq_ignore_ascii_case("Prophesee"))
    }

    /// Size of the pixel array: stated, or that of the sensor which the file names; and in the latter case
    /// from what it was taken.
    pub(super) fn extent(&self) -> Option<(Extent, Option<String>)> {
        let stated = self.stated_extent().map(|extent| (extent, None));
        stated.or_else(|| {
            self.extent_of_sensor().map(|(extent, key, value)| {
                (extent, Some(format!("size of the sensor that the header names: {key} {value}")))
            })
        })
    }

    fn stated_extent(&self) -> Option<Extent> {
        let of = |width: &str, height: &str| {
            let (width, height) = (width.trim().parse().ok()?, height.trim().parse().ok()?);
            (1..=1 << 14).contains(&width).then_some(())?;
            (1..=1 << 14).contains(&height).then_some(Extent { width, height })
        };
        let geometry = self
            .get("geometry")
            .and_then(|size| size.split_once('x'))
            .and_then(|(width, height)| of(width, height));
        let options = || of(self.option("width")?, self.option("height")?);
        let fields = || of(self.get("Width")?, self.get("Height")?);
        geometry.or_else(options).or_else(fields)
    }

    /// Size, and the key and value that it follows from.
    fn extent_of_sensor(&self) -> Option<(Extent, &'static str, &str)> {
        const VGA: Option<Extent> = Some(Extent { width: 640, height: 480 });
        const HD: Option<Extent> = Some(Extent { width: 1280, height: 720 });
        const SMALL: Option<Extent> = Some(Extent { width: 320, height: 320 });
        let named = |name: &str| {
            let name = name.to_lowercase();
            // "gen3" and "gen31", "gen4" and "gen41", as plugins and sensors are called; "genx320" and
            // "saphir" are one sensor.
            let generation = ["gen3", "gen4"].into_iter().find(|generation| name.contains(generation));
            match generation {
                _ if name.contains("genx320") || name.contains("saphir") => SMALL,
                _ if name.contains("imx636") => HD,
                Some("gen3") => VGA,
                Some(_) => HD,
                None => None,
            }
        };
        let of_generation = |generation: &str| match generation {
            "3.0" | "3.1" => VGA,
            "4.0" | "4.1" | "4.2" => HD,
            _ => None,
        };
        let of_system = |id: &str| match id.parse::<u32>().ok().filter(|_| self.is_by_maker())? {
            0x1C | 0x1D | 0x21 | 0x22 | 0x23 | 0x28 | 0x29 => VGA,
            0x1E | 0x1F | 0x20 | 0x27 | 0x2E | 0x30 | 0x31 | 0x32 | 0x3A | 0x42 => HD,
            0x3B | 0x40 => SMALL,
            _ => None,
        };
        let from = |key: &'static str, size: &dyn Fn(&str) -> Option<Extent>| {
            self.get(key).and_then(|value| Some((size(value)?, key, value)))
        };
        let generation =
            || from("sensor_generation", &of_generation).or_else(|| from("generation", &of_generation));
        from("sensor_name", &named)
            .or_else(generation)
            .or_else(|| from("plugin_name", &named))
            .or_else(|| from("system_ID", &of_system))
    }

    /// What the header says, for people.
    pub(super) fn facts(&self) -> Vec<(String, String)> {
        let mut facts = Vec::new();
        let mut fact =
            |name: &str, value: Option<String>| facts.extend(value.map(|value| (name.into(), value)));
        let integrator = self.get("camera_integrator_name").or(self.get("integrator_name"));
        let camera = [
            integrator.map(str::to_owned),
            self.get("plugin_name").map(str::to_owned),
            self.get("serial_number").map(|serial| format!("serial {serial}")),
        ];
        let camera: Vec<String> = camera.into_iter().flatten().collect();
        fact("camera", (!camera.is_empty()).then(|| camera.join(" ")));
        let generation = self
            .get("sensor_generation")
            .or(self.get("generation"))
            .map(|generation| format!("generation {generation}"));
        fact("sensor", self.get("sensor_name").map(str::to_owned).or(generation));
        fact("date", self.get("date").map(str::to_owned));
        fact("firmware", self.get("firmware_version").map(str::to_owned));
        facts
    }
}

/// The next line of the header, without its end; `None` where data begin. Binary data may begin with `%` too,
/// but hardly with a line of text.
fn line(bytes: &[u8]) -> Option<&str> {
    if bytes.first() != Some(&b'%') {
        return None;
    }
    let end = bytes.iter().position(|&byte| byte == b'\n')?;
    let text = std::str::from_utf8(&bytes[..end]).ok()?;
    let printable = !text.trim_end_matches('\r').chars().any(|letter| letter.is_control() && letter != '\t');
    let parted = text.len() == 1 || text[1..].starts_with([' ', '\t', '\r']);
    (printable && parted).then_some(text)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn parse(text: &str) -> Header {
        Header::parse(text.as_bytes()).expect("a header")
    }

    #[test]
    fn a_new_header_says_format_and_size() {
        let text = "% evt 3.0\n% format EVT3;height=720;width=1280\n% geometry 1280x720\n% end\n% not of \
                    the header\n";
        let header = parse(text);
        assert_eq!(header.encoding(), Some(Encoding::Evt3));
        assert_eq!(header.extent(), Some((Extent { width: 1280, height: 720 }, None)));
        assert_eq!(Some(header.data_at), text.find("% not"));
    }

    #[test]
    fn an_old_header_ends_where_data_begin() {
        let mut bytes =
            b"% Date 2020-09-25 07:48:31\n% plugin_name hal_plugin_gen3_fx3\n% system_ID 21\n% evt 2.0\n"
                .to_vec();
        let data_at = bytes.len();
        // Data that begin like a line of the header.
        bytes.extend(b"% \x01\x80\n\x00\x00\x00");
        let header = Header::parse(&bytes).expect("a header");
        assert_eq!((header.encoding(), header.data_at), (Some(Encoding::Evt2), data_at));
        let (extent, from) = header.extent().expect("gen3 has 640 x 480 pixels");
        assert_eq!(
            (extent, from.as_deref()),
            (
                Extent { width: 640, height: 480 },
                Some("size of the sensor that the header names: plugin_name hal_plugin_gen3_fx3")
            )
        );
        assert_eq!(header.get("DATE"), Some("2020-09-25 07:48:31"));
    }

    #[test]
    fn the_size_is_that_of_a_sensor_only_where_it_is_certain() {
        let of = |text: &str| parse(text).extent().map(|(extent, _)| (extent.width, extent.height));
        assert_eq!(of("% plugin_name hal_plugin_gen41_evk3\n"), Some((1280, 720)));
        assert_eq!(of("% sensor_name GenX320\n"), Some((320, 320)));
        assert_eq!(of("% generation 4.2\n"), Some((1280, 720)));
        assert_eq!(of("% system_ID 49\n"), Some((1280, 720)));
        assert_eq!(of("% system_ID 49\n% integrator_name Another\n"), None);
        assert_eq!(of("% plugin_name my_plugin\n"), None);
        assert_eq!(of("% geometry 0x720\n"), None);
        assert_eq!(of("% geometry 99999999999x1\n"), None);
    }

    #[test]
    fn the_order_of_halves_is_stated_or_follows_from_the_camera() {
        assert!(parse("% format EVT21;endianness=legacy\n").is_legacy());
        assert!(!parse("% format EVT21;endianness=little\n% system_ID 49\n").is_legacy());
        assert!(parse("% evt 2.1\n% system_ID 49\n% integrator_name Prophesee\n").is_legacy());
        assert!(!parse("% evt 2.1\n% system_ID 64\n").is_legacy());
    }
}
