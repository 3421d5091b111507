//! DATEX II v3 `MeasurementSiteTablePublication`: which sites there are and where, as XML.
//!
//! Owns names and order of the elements, from the v3.5 schema. The table is the one that
//! `datex2` refers to, `verge` in version 1; the indexes of its characteristics are those of the
//! measured values. Where a site is stands in its messages (`[site]` of its configuration).

use super::datex2::{NO_COUNTRY, escaped};
use crate::{Density, Lane, Place, Utc};
use std::fmt::Write;

/// Closes what [`begin`] opens.
pub const END: &str = "  </roa:measurementSiteTable>\n</d2:payload>";

/// The publication's head, made at `time`, by a publisher in `country` (ISO 3166-1 alpha-2).
pub fn begin(time: Utc, country: Option<&str>) -> String {
    format!(
        "<?xml version=\"1.0\" encoding=\"UTF-8\"?>
<d2:payload xmlns:d2=\"http://datex2.eu/schema/3/d2Payload\" \
xmlns:roa=\"http://datex2.eu/schema/3/roadTrafficData\" \
xmlns:loc=\"http://datex2.eu/schema/3/locationReferencing\" \
xmlns:com=\"http://datex2.eu/schema/3/common\" \
xmlns:xsi=\"http://www.w3.org/2001/XMLSchema-instance\" \
xsi:type=\"roa:MeasurementSiteTablePublication\" lang=\"en\" modelBaseVersion=\"3\">
  <com:publicationTime>{time}</com:publicationTime>
  <com:publicationCreator>
    <com:country>{}</com:country>
    <com:nationalIdentifier>verge</com:nationalIdentifier>
  </com:publicationCreator>
  <roa:headerInformation>
    <com:informationStatus>real</com:informationStatus>
  </roa:headerInformation>
  <roa:measurementSiteTable id=\"verge\" version=\"1\">",
        escaped(country.unwrap_or(NO_COUNTRY)),
    )
}

/// The site of a message, or what its message lacks: the schema asks for a location.
///
/// # Errors
/// Advice, where the message has no position.
pub fn site(message: &Density) -> Result<String, String> {
    let no_position = || {
        let site = &message.site;
        format!("site {site:?} has no position: give latitude and longitude under [site]")
    };
    let place = message.place.as_ref().ok_or_else(no_position)?;
    let [latitude, longitude] = place.position().ok_or_else(no_position)?;
    let mut xml = format!(
        "    <roa:measurementSite id=\"{}\" version=\"1\">
      <roa:measurementEquipmentTypeUsed>
        <com:values><com:value lang=\"en\">video</com:value></com:values>
      </roa:measurementEquipmentTypeUsed>
      <roa:measurementSiteName>
        <com:values><com:value lang=\"en\">{}</com:value></com:values>
      </roa:measurementSiteName>
      <roa:measurementSiteNumberOfLanes>{}</roa:measurementSiteNumberOfLanes>
      <roa:measurementSiteIdentification>{}</roa:measurementSiteIdentification>",
        escaped(&message.site),
        escaped(place.name.as_deref().unwrap_or(&message.site)),
        message.lanes.len(),
        escaped(&message.site),
    );
    for lane in &message.lanes {
        let followed = lane.traffic.is_some();
        let kinds = [
            (0, "trafficConcentration", true),
            (10, "trafficFlow", followed),
            (20, "trafficSpeed", followed),
        ];
        for (beside, kind, _) in kinds.into_iter().filter(|(.., is_measured)| *is_measured) {
            characteristics(&mut xml, lane, beside, kind, message.window_s);
        }
    }
    location(&mut xml, place, [latitude, longitude]);
    xml.push_str("\n    </roa:measurementSite>");
    Ok(xml)
}

fn characteristics(xml: &mut String, lane: &Lane, beside: u8, kind: &str, window_s: u32) {
    // A string takes what is written to it.
    let _ = write!(
        xml,
        "
      <roa:measurementSpecificCharacteristics index=\"{}\">
        <roa:measurementSpecificCharacteristics>
          <roa:period>{window_s}</roa:period>
          <roa:specificMeasurementValueType>{kind}</roa:specificMeasurementValueType>",
        lane.lane + beside,
    );
    if let Some(order) = lane.lane_order {
        let _ = write!(
            xml,
            "
          <roa:specificLane>
            <loc:laneNumber>{order}</loc:laneNumber>
          </roa:specificLane>"
        );
    }
    xml.push_str(
        "
        </roa:measurementSpecificCharacteristics>
      </roa:measurementSpecificCharacteristics>",
    );
}

fn location(xml: &mut String, place: &Place, [latitude, longitude]: [f64; 2]) {
    xml.push_str("\n      <roa:measurementSiteLocation xsi:type=\"loc:PointLocation\">");
    let words: Vec<_> = [&place.road, &place.direction].into_iter().flatten().collect();
    if !words.is_empty() {
        let words = words.into_iter().map(String::as_str).collect::<Vec<_>>().join(", ");
        let _ = write!(
            xml,
            "
        <loc:supplementaryPositionalDescription>
          <loc:locationDescription>
            <com:values><com:value lang=\"en\">{}</com:value></com:values>
          </loc:locationDescription>
        </loc:supplementaryPositionalDescription>",
            escaped(&words)
        );
    }
    xml.push_str("\n        <loc:pointByCoordinates>");
    if let Some(bearing) = place.bearing {
        // AngleInDegrees: whole ones below 360.
        let _ = write!(xml, "\n          <loc:bearing>{}</loc:bearing>", bearing.round() % 360.0);
    }
    let _ = write!(
        xml,
        "
          <loc:pointCoordinates>
            <loc:latitude>{latitude}</loc:latitude>
            <loc:longitude>{longitude}</loc:longitude>
          </loc:pointCoordinates>
        </loc:pointByCoordinates>
      </roa:measurementSiteLocation>"
    );
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::formats::tests::{followed, message, placed};

    #[test]
    fn a_site_without_a_position_is_refused() {
        let error = site(&message()).expect_err("no place");
        assert!(error.contains("give latitude and longitude under [site]"), "{error}");
        let nameless = message().at(&Place { road: Some("A1".into()), ..Place::default() }, &[]);
        assert!(site(&nameless).is_err());
    }

    #[test]
    fn lanes_and_what_is_measured_of_them_are_listed() {
        let xml = site(&placed(followed())).expect("a position");
        for (part, count) in [
            ("<roa:measurementSpecificCharacteristics index=", 6),
            (">trafficFlow<", 2),
            ("<loc:laneNumber>2</loc:laneNumber>", 3),
            ("<loc:bearing>120</loc:bearing>", 1),
            ("<loc:latitude>22.36251</loc:latitude>", 1),
            ("Tuen Mun Road, to Kowloon", 1),
        ] {
            assert_eq!(xml.matches(part).count(), count, "{part}: {xml}");
        }
        assert_eq!(site(&placed(message())).expect("right").matches("trafficFlow").count(), 0);
    }
}
