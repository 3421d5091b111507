//! DATEX II v3 `MeasuredDataPublication` with `TrafficConcentration`, and `TrafficFlow` and
//! `TrafficSpeed` where vehicles are followed, as XML.
//!
//! Owns names, order and units of the elements, from the v3.5 schema. A lane is one
//! indexed physical quantity (index: the lane's number; 10 and 20 more for flow and speed). `densityOfVehicles` is a whole
//! number and required where `density` stands, so that a missing density becomes a
//! `physicalQuantityFault` without values, never by 0.

use crate::{Density, Lane, Status, Utc};
use std::fmt::Write;

/// Country of a publisher that does not tell: a code that ISO 3166-1 leaves to its users.
pub(super) const NO_COUNTRY: &str = "ZZ";

/// Closes what [`begin`] opens.
pub const END: &str = "</d2:payload>";

/// The publication's head, made at `time`, by a publisher in `country` (ISO 3166-1 alpha-2).
pub fn begin(time: Utc, country: Option<&str>) -> String {
    format!(
        "<?xml version=\"1.0\" encoding=\"UTF-8\"?>
<d2:payload xmlns:d2=\"http://datex2.eu/schema/3/d2Payload\" \
xmlns:roa=\"http://datex2.eu/schema/3/roadTrafficData\" \
xmlns:com=\"http://datex2.eu/schema/3/common\" \
xmlns:xsi=\"http://www.w3.org/2001/XMLSchema-instance\" \
xsi:type=\"roa:MeasuredDataPublication\" lang=\"en\" modelBaseVersion=\"3\">
  <com:publicationTime>{}</com:publicationTime>
  <com:publicationCreator>
    <com:country>{}</com:country>
    <com:nationalIdentifier>verge</com:nationalIdentifier>
  </com:publicationCreator>
  <roa:measurementSiteTableReference targetClass=\"roa:MeasurementSiteTable\" id=\"verge\" \
version=\"1\"/>
  <roa:headerInformation>
    <com:informationStatus>real</com:informationStatus>
  </roa:headerInformation>",
        time,
        escaped(country.unwrap_or(NO_COUNTRY)),
    )
}

/// One message: the measurements of its site in its window.
pub fn site_measurements(message: &Density) -> String {
    let mut xml = format!(
        "  <roa:siteMeasurements>
    <roa:measurementSiteReference targetClass=\"roa:MeasurementSite\" id=\"{}\" version=\"1\"/>",
        escaped(&message.site)
    );
    for lane in &message.lanes {
        // A string takes what is written to it.
        let _ = write!(
            xml,
            "
    <roa:physicalQuantity index=\"{}\">
      <roa:physicalQuantity xsi:type=\"roa:SinglePhysicalQuantity\">
{}
      </roa:physicalQuantity>
    </roa:physicalQuantity>",
            lane.lane,
            concentration(lane).unwrap_or_else(|| fault(lane.status, message.to)),
        );
        for (beside, values) in moving(lane, message.to).into_iter().flatten() {
            let _ = write!(
                xml,
                "
    <roa:physicalQuantity index=\"{}\">
      <roa:physicalQuantity xsi:type=\"roa:SinglePhysicalQuantity\">
{values}
      </roa:physicalQuantity>
    </roa:physicalQuantity>",
                lane.lane + beside,
            );
        }
    }
    let (from, to) = (message.from, message.to);
    let _ = write!(
        xml,
        "
    <roa:measurementTimeDefault>
      <roa:timeMeaning>endTime</roa:timeMeaning>
      <roa:timeValue>{to}</roa:timeValue>
      <roa:period>
        <com:startOfPeriod>{from}</com:startOfPeriod>
        <com:endOfPeriod>{to}</com:endOfPeriod>
        <com:periodName>
          <com:values><com:value lang=\"en\">{} s</com:value></com:values>
        </com:periodName>
      </roa:period>
    </roa:measurementTimeDefault>
  </roa:siteMeasurements>",
        message.window_s,
    );
    xml
}

/// The values of a lane, or `None` where its density is missing.
fn concentration(lane: &Lane) -> Option<String> {
    let density = lane.density_veh_km?;
    let deviation = lane
        .density_se
        .map_or_else(String::new, |error| format!(" standardDeviation=\"{error:.2}\""));
    let accuracy =
        accuracy(lane).map_or_else(String::new, |percent| format!(" accuracy=\"{percent:.1}\""));
    let expected = lane.frames_expected.max(1);
    let quality = 100.0 * (lane.frames_used as f32 / expected as f32).min(1.0);
    let occupancy = match &lane.traffic {
        Some(traffic) => traffic.time_occupancy,
        None => lane.space_occupancy,
    };
    let occupancy = occupancy.map_or_else(String::new, |share| {
        format!(
            "
          <roa:occupancy>
            <com:percentage>{:.1}</com:percentage>
          </roa:occupancy>",
            share * 100.0
        )
    });
    Some(format!(
        "        <roa:basicData xsi:type=\"roa:TrafficConcentration\">
          <roa:density{accuracy} numberOfInputValuesUsed=\"{}\"{deviation} \
supplierCalculatedDataQuality=\"{quality:.1}\">
            <roa:densityOfVehicles>{}</roa:densityOfVehicles>
          </roa:density>{occupancy}
        </roa:basicData>",
        lane.frames_used,
        // `as` saturates.
        density.round() as u32,
    ))
}

/// "The extent to which the data value may be subject to error, measured as a percentage of the
/// data value": the further end of the 90 % interval. None of an empty road.
fn accuracy(lane: &Lane) -> Option<f32> {
    let (density, [low, high]) = lane.density_veh_km.zip(lane.density_ci90)?;
    let percent = 100.0 * (high - density).max(density - low) / density;
    percent.is_finite().then_some(percent)
}

/// Flow and speed of a lane with what is added to its number, where vehicles are followed.
fn moving(lane: &Lane, time: Utc) -> [Option<(u8, String)>; 2] {
    let Some(traffic) = &lane.traffic else { return [None, None] };
    let values = |kind: &str, element: &str, value: &str, number: String| {
        format!(
            "        <roa:basicData xsi:type=\"roa:{kind}\">
          <roa:{element}>
            <roa:{value}>{number}</roa:{value}>
          </roa:{element}>
        </roa:basicData>"
        )
    };
    let flow = traffic.flow_veh_h.map(|flow| {
        // `as` saturates.
        let rate = (flow.round() as u32).to_string();
        values("TrafficFlow", "vehicleFlow", "vehicleFlowRate", rate)
    });
    let speed = traffic
        .speed_kmh
        .map(|speed| values("TrafficSpeed", "averageVehicleSpeed", "speed", format!("{speed:.1}")));
    let is_ok = traffic.traffic_status == Status::Ok;
    let fault = || fault(traffic.traffic_status, time);
    // Where no vehicle was there is no speed, and no fault.
    let speed = speed.or_else(|| (!is_ok).then(fault));
    [Some((10, flow.unwrap_or_else(fault))), speed.map(|speed| (20, speed))]
}

/// Why a lane has no values.
fn fault(status: Status, time: Utc) -> String {
    let kind = match status {
        Status::SensorFailure => "noDataValuesAvailable",
        Status::Ok
        | Status::InputDataIntegrity
        | Status::PoorContrast
        | Status::DetectionAutoSuspended => "spuriousUnreliableDataValues",
    };
    format!(
        "        <roa:physicalQuantityFault>
          <com:faultDescription>
            <com:values><com:value lang=\"en\">{}</com:value></com:values>
          </com:faultDescription>
          <com:faultLastUpdateTime>{}</com:faultLastUpdateTime>
          <roa:physicalQuantityFaultType>{kind}</roa:physicalQuantityFaultType>
        </roa:physicalQuantityFault>",
        status.name(),
        time,
    )
}

/// Text for content and attributes; what XML 1.0 cannot hold becomes U+FFFD.
pub(super) fn escaped(text: &str) -> String {
    let mut xml = String::new();
    for character in text.chars() {
        match character {
            '&' => xml.push_str("&amp;"),
            '<' => xml.push_str("&lt;"),
            '>' => xml.push_str("&gt;"),
            '"' => xml.push_str("&quot;"),
            '\t' | '\n' | '\r' => xml.push(' '),
            '\0'..='\u{1f}' | '\u{fffe}' | '\u{ffff}' => xml.push('\u{fffd}'),
            _ => xml.push(character),
        }
    }
    xml
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::formats::tests::{followed, message};

    #[test]
    fn golden_site_measurements() {
        let expected = "  <roa:siteMeasurements>
    <roa:measurementSiteReference targetClass=\"roa:MeasurementSite\" \
id=\"k109f &quot;&lt;&amp;&gt;&quot;, east\" version=\"1\"/>
    <roa:physicalQuantity index=\"1\">
      <roa:physicalQuantity xsi:type=\"roa:SinglePhysicalQuantity\">
        <roa:basicData xsi:type=\"roa:TrafficConcentration\">
          <roa:density accuracy=\"34.0\" numberOfInputValuesUsed=\"57\" standardDeviation=\"3.50\" \
supplierCalculatedDataQuality=\"95.0\">
            <roa:densityOfVehicles>24</roa:densityOfVehicles>
          </roa:density>
          <roa:occupancy>
            <com:percentage>12.3</com:percentage>
          </roa:occupancy>
        </roa:basicData>
      </roa:physicalQuantity>
    </roa:physicalQuantity>
    <roa:physicalQuantity index=\"2\">
      <roa:physicalQuantity xsi:type=\"roa:SinglePhysicalQuantity\">
        <roa:physicalQuantityFault>
          <com:faultDescription>
            <com:values><com:value lang=\"en\">poorContrast</com:value></com:values>
          </com:faultDescription>
          <com:faultLastUpdateTime>2026-01-05T08:01:00.000Z</com:faultLastUpdateTime>
          <roa:physicalQuantityFaultType>spuriousUnreliableDataValues\
</roa:physicalQuantityFaultType>
        </roa:physicalQuantityFault>
      </roa:physicalQuantity>
    </roa:physicalQuantity>
    <roa:measurementTimeDefault>
      <roa:timeMeaning>endTime</roa:timeMeaning>
      <roa:timeValue>2026-01-05T08:01:00.000Z</roa:timeValue>
      <roa:period>
        <com:startOfPeriod>2026-01-05T08:00:00.000Z</com:startOfPeriod>
        <com:endOfPeriod>2026-01-05T08:01:00.000Z</com:endOfPeriod>
        <com:periodName>
          <com:values><com:value lang=\"en\">60 s</com:value></com:values>
        </com:periodName>
      </roa:period>
    </roa:measurementTimeDefault>
  </roa:siteMeasurements>";
        assert_eq!(site_measurements(&message()), expected);
    }

    #[test]
    fn flow_and_speed_where_vehicles_are_followed() {
        let xml = site_measurements(&followed());
        let flow = "<roa:physicalQuantity index=\"11\">
      <roa:physicalQuantity xsi:type=\"roa:SinglePhysicalQuantity\">
        <roa:basicData xsi:type=\"roa:TrafficFlow\">
          <roa:vehicleFlow>
            <roa:vehicleFlowRate>876</roa:vehicleFlowRate>
          </roa:vehicleFlow>
        </roa:basicData>";
        assert!(xml.contains(flow), "{xml}");
        let speed = "<roa:averageVehicleSpeed>
            <roa:speed>36.1</roa:speed>";
        assert!(xml.contains(speed) && xml.contains("index=\"21\""), "{xml}");
        assert!(xml.contains("<com:percentage>10.0</com:percentage>"), "the time occupancy");
        // Of the second lane nothing is known: three faults.
        assert_eq!(xml.matches("<roa:physicalQuantityFault>").count(), 3);
    }

    #[test]
    fn text_that_xml_cannot_hold_is_replaced() {
        assert_eq!(escaped("a\u{1}<\n\"&"), "a\u{fffd}&lt; &quot;&amp;");
    }
}
