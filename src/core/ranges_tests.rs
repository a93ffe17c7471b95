//! Descriptions with ranges.

use super::*;
use crate::document::Source;
use crate::sensor::Sensor;

const TEXT: &str = r#"
format = "photocurrent-sensor/1"
[front_end]
tau_0 = "20 us"
alpha = ["4 ms", "25 ms"]
[comparator]
threshold_on = [0.1, 0.4]
threshold_off = 0.2
[frames]
black_level_dn = [-10, 30]
"#;

fn parse(text: &str) -> Result<Sensor, Vec<Problem>> {
    Sensor::parse(&Source::new("s.toml", "", text))
}

#[test]
fn the_middle_of_a_range_stands_for_the_number() {
    let sensor = parse(TEXT).unwrap();
    assert_eq!(sensor.front_end.alpha, Some(Duration::new(10_000_000)));
    assert!((sensor.comparator.threshold_on.unwrap() - 0.2).abs() < 1e-12);
    assert_eq!(sensor.frames.black_level_dn, Some(10.0));
    assert_eq!(sensor.ranges["front_end.alpha"].ends(), [4e-3, 25e-3]);
    assert_eq!((sensor.ranges.len(), sensor.ranges["front_end.alpha"].unit()), (3, "s"));
}

#[test]
fn ranges_survive_being_written_as_json_and_as_toml() {
    let sensor = parse(TEXT).unwrap();
    assert_eq!(serde_json::from_str::<Sensor>(&sensor.canonical_json()).unwrap(), sensor);
    assert!(sensor.to_toml().contains("alpha = [\"4 ms\", \"25 ms\"]"), "{}", sensor.to_toml());
    assert_eq!(parse(&sensor.to_toml()).unwrap(), sensor);
}

#[test]
fn what_is_no_range_is_refused_where_it_stands() {
    let of = |text: &str| parse(&TEXT.replace("[\"4 ms\", \"25 ms\"]", text)).unwrap_err();
    for (text, why) in [
        ("[\"4 ms\"]", "it has 1 values"),
        ("[\"25 ms\", \"4 ms\"]", "not below"),
        ("[4, 25]", "a time such as"),
        ("[\"4 ms\", \"25\"]", "has no unit"),
        ("[\"-4 ms\", \"25 ms\"]", "positive"),
    ] {
        let problems = of(text);
        assert_eq!(problems.len(), 1, "{problems:?}");
        assert!(problems[0].message.contains(why), "{}", problems[0].message);
        assert_eq!(problems[0].at.as_ref().unwrap().line_column(), (5, 9));
    }
    // What may hold none says so.
    let problems = parse(&TEXT.replace("[frames]", "[frames]\ngain = [1, 2]")).unwrap_err();
    assert!(problems[0].message.contains("list"), "{}", problems[0].message);
    assert!(parse(&format!("{TEXT}[ranges]\n")).is_err());
}
