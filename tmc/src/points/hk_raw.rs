//! Hong Kong's raw feed: XML with speed, occupancy and volume of each lane in 30 s.
//!
//! Density is k = q / v with q 120 times the volume; a lane that is not valid is left out.
//! Reads the elements it needs and passes over others.

use super::Readings;
use crate::gzip::read_text;
use quick_xml::Reader;
use quick_xml::escape::resolve_predefined_entity;
use quick_xml::events::Event;
use std::path::Path;
use verge_desk::Failure;

/// From 30 s to an hour.
const PER_HOUR: f64 = 120.0;

/// A lane before its element ends.
#[derive(Default)]
struct Lane {
    name: String,
    speed: Option<f64>,
    volume: Option<f64>,
    valid: bool,
}

/// Readings of every detector, lane and period.
pub(super) fn read(path: &Path) -> Result<Readings, Failure> {
    let text = read_text(path)?;
    let mut reader = Reader::from_str(&text);
    let mut readings = Readings::default();
    let (mut detector, mut lane) = (String::new(), Lane::default());
    let (mut open, mut content) = (Vec::new(), String::new());
    loop {
        let event = reader.read_event();
        // Where the event ends, or the fault begins.
        let at = if event.is_err() { reader.error_position() } else { reader.buffer_position() };
        let before = text.get(..at as usize).unwrap_or(&text);
        let wrong =
            |reason: String| Failure::content(path, 1 + before.matches('\n').count(), reason);
        match event.map_err(|error| wrong(format!("is not XML ({error}); fetch the file again")))? {
            Event::Start(tag) => {
                open.push(tag.name().0.to_owned());
                content.clear();
            }
            Event::Text(text) => content.push_str(&text),
            Event::GeneralRef(entity) => {
                content.push_str(resolve_predefined_entity(&entity).unwrap_or_default());
            }
            Event::End(_) => {
                let name = open.pop().unwrap_or_default();
                let content = content.trim();
                let number = || {
                    let value = content.parse::<f64>().ok().filter(|v| v.is_finite() && *v >= 0.0);
                    value.ok_or_else(|| {
                        wrong(format!("<{name}> {content:?} is not a number from 0"))
                    })
                };
                match name.as_str() {
                    "detector_id" => content.clone_into(&mut detector),
                    "lane_id" => content.clone_into(&mut lane.name),
                    "speed" if !content.is_empty() => lane.speed = Some(number()?),
                    "volume" if !content.is_empty() => lane.volume = Some(number()?),
                    "valid" => lane.valid = content == "Y",
                    "lane" => {
                        let ended = std::mem::take(&mut lane);
                        match (ended.valid, ended.volume, ended.speed) {
                            (true, Some(volume), Some(speed)) => {
                                let flow = volume * PER_HOUR;
                                readings.add_flow(&detector, &ended.name, flow, speed);
                            }
                            _ => readings.invalid += 1,
                        }
                    }
                    _ => {}
                }
            }
            Event::Eof => match open.last() {
                Some(name) => {
                    return Err(wrong(format!("ends inside <{name}>; fetch the file again")));
                }
                None if readings.kept.is_empty() && readings.invalid + readings.empty == 0 => {
                    return Err(wrong("has no <lane>; is it Hong Kong's raw feed?".into()));
                }
                None => return Ok(readings),
            },
            _ => {}
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn of(text: &str) -> Result<Readings, Failure> {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("feed.xml");
        std::fs::write(&path, text).unwrap();
        read(&path)
    }

    const LANE: &str = "<lane><lane_id>Fast &amp; Slow</lane_id><speed>60</speed>\
        <occupancy>1</occupancy><volume>3</volume><s.d.>7.5</s.d.><valid>Y</valid></lane>";

    #[test]
    fn a_lane_is_read_and_an_invalid_one_is_not() {
        let invalid = LANE.replace(">Y<", ">N<");
        let text = format!(
            "<?xml version=\"1.0\"?><l a=\"b\"><detector><detector_id>A1</detector_id>{LANE}\
             {invalid}</detector></l>"
        );
        let readings = of(&text).unwrap();
        assert_eq!((readings.kept.len(), readings.invalid), (1, 1));
        assert_eq!(readings.kept[0].density, 6.0);
        assert_eq!(readings.kept[0].detector, "A1");
        assert_eq!(readings.kept[0].lane, "Fast & Slow");
    }

    #[test]
    fn damage_is_said() {
        for (text, said) in [
            (format!("<l>\n{LANE}"), "ends inside <l>"),
            ("<l><speed>fast</speed></l>".to_owned(), "<speed> \"fast\" is not a number"),
            ("<l>\n</m>".to_owned(), "line 2: is not XML"),
            ("<l><spe".to_owned(), "is not XML"),
            ("<l></l>".to_owned(), "has no <lane>"),
        ] {
            let error = of(&text).unwrap_err().to_string();
            assert!(error.contains(said), "{error}");
        }
    }
}
