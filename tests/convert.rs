//! `verge convert`: real messages through the program, and the DATEX II output against the
//! content models of the published v3.5 schema.

mod common;
#[path = "common/windows.rs"]
mod windows;

use common::{folder, stderr, verge};
use std::fs;
use verge::daemon::publish::payload;
use verge::density::SampleZoneStatus;
use verge::wire::{self, DensityMessage};

/// A minute with vehicles, and one without a picture.
fn messages() -> Vec<DensityMessage> {
    let table = fs::read(common::K109F_TABLE).expect("it ships");
    windows::messages(table, "k109f", SampleZoneStatus::SensorFailure)
}

fn json_lines() -> String {
    let lines: Vec<_> = messages()
        .iter()
        .map(|message| String::from_utf8(payload::density(message, None)).expect("JSON"))
        .collect();
    lines.join("\n") + "\n"
}

/// Converts `input` and returns exit code, output and errors.
fn convert(input: &str, args: &[&str]) -> (Option<i32>, String, String) {
    let folder = folder();
    let path = folder.path().join("messages");
    fs::write(&path, input).expect("writing the messages");
    let path = path.to_str().expect("UTF-8");
    let output = verge(&[&["convert", path], args].concat());
    let text = String::from_utf8(output.stdout.clone()).expect("UTF-8");
    (output.status.code(), text, stderr(&output))
}

#[test]
fn every_format_takes_the_daemons_messages() {
    let input = json_lines();
    let lanes: usize = messages().iter().map(|message| message.report.lanes.len()).sum();
    for (format, lines) in [("json", 2), ("csv", lanes + 1), ("ntcip", lanes), ("fiware", 2)] {
        let (code, output, errors) = convert(&input, &["--to", format]);
        assert_eq!((code, errors.as_str()), (Some(0), ""), "{format}");
        assert_eq!(output.lines().count(), lines, "{format}: {output}");
    }
    let (_, output, _) = convert(&input, &["--to", "json"]);
    assert_eq!(output, input);
}

#[test]
fn postcard_and_json_say_the_same() {
    let mut buffer = [0; wire::MAX_MESSAGE];
    let hex: Vec<String> = messages()
        .iter()
        .map(|message| {
            let bytes = wire::encode(message, &mut buffer).expect("fits");
            bytes.iter().map(|byte| format!("{byte:02X}")).collect()
        })
        .collect();
    let (code, output, _) = convert(&hex.join("\n"), &["--from", "postcard", "--to", "json"]);
    assert_eq!((code, output), (Some(0), json_lines()));
}

#[test]
fn what_people_pipe_into_it_is_read() {
    let lines = json_lines();
    let values: Vec<serde_json::Value> =
        lines.lines().map(|line| serde_json::from_str(line).expect("JSON")).collect();
    let wrapped = |wrap: fn(&serde_json::Value) -> serde_json::Value| -> String {
        values.iter().map(|value| wrap(value).to_string() + "\n").collect()
    };
    let pretty = |value: &serde_json::Value| serde_json::to_string_pretty(value).expect("JSON");
    for input in [
        lines.lines().map(|line| format!("verge/k109f/density/60s {line}\r\n")).collect(),
        serde_json::to_string(&values).expect("JSON"),
        pretty(&serde_json::json!(values)),
        values.iter().map(pretty).collect::<Vec<_>>().join("\n"),
        // mosquitto_sub -F %j, then -F %J; Node-RED and others.
        wrapped(|value| {
            serde_json::json!({"tst": "2026-01-05T08:01:00.1Z", "topic": "verge/k109f/\
            density/60s", "qos": 1, "retain": 0, "payloadlen": 9, "payload": value.to_string()})
        }),
        wrapped(|value| serde_json::json!({"topic": "a", "payload": value})),
        wrapped(|value| serde_json::json!({"key": null, "value": {"payload": value.to_string()}})),
        // jq without -r; a consumer that gives lists.
        wrapped(|value| value.to_string().into()),
        serde_json::json!({"records": [{"value": values[0]}, {"value": values[1]}]}).to_string(),
    ] {
        let (code, output, errors) = convert(&input, &["--to", "json"]);
        assert_eq!(
            (code, output.as_str(), errors.as_str()),
            (Some(0), lines.as_str(), ""),
            "{input}"
        );
    }
}

#[test]
fn what_else_comes_under_the_topics_is_left_out_and_other_forms_are_named() {
    use std::io::Write;
    let lines = json_lines();
    let health = r#"{"schema":1,"site":"k109f","uptime_s":7}"#;
    let presence = "verge/k/presence online\nverge/k/presence offline\nverge/k/presence shutdown";
    let input = format!("{presence}\nverge/k/health {health}\n{lines}");
    let (code, output, errors) = convert(&input, &["--to", "json"]);
    assert_eq!((code, output.as_str()), (Some(0), lines.as_str()), "{errors}");
    assert!(errors.contains("4 of other kinds"), "{errors}");
    let (code, _, errors) = convert("", &["--to", "json"]);
    assert!(code == Some(0) && errors.contains("no density message"), "{errors}");

    let folder = folder();
    let file = folder.path().join("messages");
    let name = file.to_str().expect("UTF-8");
    let mut packed = flate2::write::GzEncoder::new(Vec::new(), flate2::Compression::fast());
    packed.write_all(lines.as_bytes()).expect("memory");
    std::fs::write(&file, packed.finish().expect("memory")).expect("written");
    let of_file = |format: &str| {
        let output = common::verge(&["convert", "--to", format, name]);
        let text = String::from_utf8_lossy(&output.stdout).into_owned();
        (output.status.code(), text, common::stderr(&output))
    };
    let (code, output, errors) = of_file("json");
    assert_eq!((code, output.as_str()), (Some(0), lines.as_str()), "{errors}");
    for (bytes, words) in [(&b"\xff\xfe{\0"[..], "UTF-16"), (b"BZh91AY", "bzip2")] {
        std::fs::write(&file, bytes).expect("written");
        let (code, output, errors) = of_file("csv");
        assert_eq!(code, Some(65), "{errors}");
        assert!(errors.contains(words) && !output.contains("null"), "{errors}");
    }
    let (_, _, errors) = convert("{'schema': 1}\n", &["--to", "json"]);
    assert!(errors.contains("json.dumps"), "{errors}");
}

#[test]
fn a_site_is_no_formula() {
    let input = json_lines().replace("k109f", "=HYPERLINK(\\\"x\\\")");
    let (code, output, errors) = convert(&input, &["--to", "csv"]);
    assert_eq!(code, Some(0), "{errors}");
    let rows: Vec<_> = output.lines().skip(1).collect();
    assert!(
        !rows.is_empty() && rows.iter().all(|row| row.starts_with("\"'=HYPERLINK(")),
        "{output}"
    );
}

#[test]
fn a_bad_line_is_named_and_the_others_are_converted() {
    let lines = json_lines();
    let (first, second) = lines.split_once('\n').expect("two messages");
    let input = format!("{first}\n\n{{\"schema\":1}}\n{second}");
    let (code, output, errors) = convert(&input, &["--to", "json"]);
    assert_eq!(code, Some(65), "{errors}");
    assert_eq!(output, lines);
    assert!(errors.contains("line 3: not a density message: site is missing"), "{errors}");
    assert!(errors.contains("1 of 3 messages"), "{errors}");
}

#[test]
fn a_file_is_there_whole_and_a_missing_input_is_named() {
    let folder = folder();
    let out = folder.path().join("out.csv");
    let out = out.to_str().expect("UTF-8");
    let (code, output, _) = convert(&json_lines(), &["--to", "csv", "--out", out]);
    assert_eq!((code, output.as_str()), (Some(0), ""));
    assert!(fs::read_to_string(out).expect("written").ends_with("\r\n"));
    let failed = verge(&["convert", "--to", "csv", "no/such/file"]);
    assert_eq!(failed.status.code(), Some(66), "{}", stderr(&failed));
    assert!(stderr(&failed).contains("no/such/file"));
    for (option, wrong) in [("--country", "Germany"), ("--road-segment", "seven")] {
        let failed = verge(&["convert", "--to", "csv", option, wrong]);
        assert_eq!(failed.status.code(), Some(64), "{}", stderr(&failed));
    }
}

#[test]
fn datex2_has_the_elements_of_the_schema_in_their_order() {
    let (code, output, _) = convert(&json_lines(), &["--to", "datex2", "--country", "hk"]);
    assert_eq!(code, Some(0));
    let (_, untold, _) = convert(&json_lines(), &["--to", "datex2"]);
    datex2::check(&xml::parse(&untold), "PayloadPublication", &mut Vec::new());
    let root = xml::parse(&output);
    assert_eq!(root.name, "d2:payload");
    assert_eq!(root.attribute("modelBaseVersion"), Some("3"));
    assert_eq!(root.attribute("lang"), Some("en"));
    let mut values = Vec::new();
    datex2::check(&root, "PayloadPublication", &mut values);
    let densities: Vec<_> = values.iter().filter(|(name, _)| name.ends_with("Vehicles")).collect();
    let lanes = messages()[0].report.lanes.len();
    assert_eq!(densities.len(), lanes, "one for each lane that was measured, none for others");
    let faults = values.iter().filter(|(name, _)| name.ends_with("FaultType")).count();
    assert_eq!(faults, lanes, "one for each lane that was not");
}

#[test]
fn the_site_table_has_each_site_once_with_its_elements_in_order() {
    let placed = json_lines()
        .replace("\"schema\":1,\"site\":\"k109f\"", "\"schema\":2,\"site\":\"k109f\",\"place\":{\
            \"name\":\"Siu Lam\",\"road\":\"Tuen Mun Road\",\"direction\":null,\"latitude\":22.3625,\
            \"longitude\":114.0125,\"bearing\":285.0}")
        .replace("\"lane\":2,", "\"lane\":2,\"lane_order\":3,");
    let (code, output, errors) = convert(&placed, &["--to", "datex2-sites"]);
    assert_eq!(code, Some(0), "{errors}");
    let mut values = Vec::new();
    datex2::check(&xml::parse(&output), "PayloadPublication", &mut values);
    let of = |name: &str| values.iter().filter(|(found, _)| found == name).collect::<Vec<_>>();
    assert_eq!(of("loc:latitude"), [&("loc:latitude".to_owned(), "22.3625".to_owned())]);
    assert_eq!(of("loc:laneNumber").len(), 1, "of the lane whose order is known");
    assert_eq!(of("roa:specificMeasurementValueType").len(), messages()[0].report.lanes.len());
    let (code, _, errors) = convert(&json_lines(), &["--to", "datex2-sites"]);
    assert_eq!(code, Some(65));
    assert!(errors.contains("give latitude and longitude under [site]"), "{errors}");
}

/// The content models that the output uses, as the v3.5 schema has them.
mod datex2 {
    use super::xml::Element;

    /// An element: its name, the least and the most number of it, and its type.
    type Particle = (&'static str, usize, usize, &'static str);

    fn model(kind: &str) -> Option<Vec<Particle>> {
        const MANY: usize = usize::MAX;
        let publication = [
            ("com:publicationTime", 1, 1, "dateTime"),
            ("com:publicationCreator", 1, 1, "InternationalIdentifier"),
        ];
        let quantity = [
            ("roa:forecast", 0, 1, "boolean"),
            ("roa:measurementEquipmentTypeUsed", 0, 1, "MultilingualString"),
            ("roa:physicalQuantityFault", 0, MANY, "PhysicalQuantityFault"),
        ];
        Some(match kind {
            "roa:MeasuredDataPublication" => [
                &publication[..],
                &[
                    ("roa:measurementSiteTableReference", 1, MANY, "Reference"),
                    ("roa:headerInformation", 1, 1, "HeaderInformation"),
                    ("roa:siteMeasurements", 1, MANY, "SiteMeasurements"),
                ],
            ]
            .concat(),
            "roa:MeasurementSiteTablePublication" => [
                &publication[..],
                &[
                    ("roa:headerInformation", 1, 1, "HeaderInformation"),
                    ("roa:measurementSiteTable", 1, MANY, "MeasurementSiteTable"),
                ],
            ]
            .concat(),
            "MeasurementSiteTable" => vec![("roa:measurementSite", 1, MANY, "MeasurementSite")],
            "MeasurementSite" => vec![
                ("roa:measurementSiteRecordVersionTime", 0, 1, "dateTime"),
                ("roa:measurementEquipmentReference", 0, 1, "string"),
                ("roa:measurementEquipmentTypeUsed", 0, 1, "MultilingualString"),
                ("roa:measurementSiteName", 0, 1, "MultilingualString"),
                ("roa:measurementSiteNumberOfLanes", 0, 1, "nonNegativeInteger"),
                ("roa:measurementSiteIdentification", 0, 1, "string"),
                ("roa:measurementSpecificCharacteristics", 0, MANY, "IndexedCharacteristics"),
                ("roa:measurementSiteLocation", 1, 1, "LocationReference"),
            ],
            "IndexedCharacteristics" => {
                vec![("roa:measurementSpecificCharacteristics", 1, 1, "Characteristics")]
            }
            "Characteristics" => vec![
                ("roa:accuracy", 0, 1, "percentage"),
                ("roa:period", 0, 1, "float"),
                ("roa:specificMeasurementValueType", 1, 1, "valueType"),
                ("roa:specificLane", 0, MANY, "Lane"),
            ],
            "Lane" => vec![("loc:laneNumber", 0, 1, "nonNegativeInteger")],
            "loc:PointLocation" => vec![
                ("loc:supplementaryPositionalDescription", 0, 1, "PositionalDescription"),
                ("loc:pointByCoordinates", 0, 1, "PointByCoordinates"),
            ],
            "PositionalDescription" => {
                vec![("loc:locationDescription", 0, 1, "MultilingualString")]
            }
            "PointByCoordinates" => vec![
                ("loc:bearing", 0, 1, "angle"),
                ("loc:pointCoordinates", 1, 1, "PointCoordinates"),
            ],
            "PointCoordinates" => {
                vec![("loc:latitude", 1, 1, "float"), ("loc:longitude", 1, 1, "float")]
            }
            "InternationalIdentifier" => {
                vec![("com:country", 1, 1, "country"), ("com:nationalIdentifier", 1, 1, "string")]
            }
            "HeaderInformation" => vec![
                ("com:confidentiality", 0, 1, "string"),
                ("com:allowedDeliveryChannel", 0, MANY, "string"),
                ("com:informationStatus", 1, 1, "real"),
            ],
            "SiteMeasurements" => vec![
                ("roa:measurementSiteReference", 1, 1, "Reference"),
                ("roa:physicalQuantity", 0, MANY, "Indexed"),
                ("roa:measurementTimeDefault", 1, 1, "MeasurementOrCalculationTime"),
            ],
            "Reference" => vec![],
            "Indexed" => vec![("roa:physicalQuantity", 1, 1, "PhysicalQuantity")],
            "roa:SinglePhysicalQuantity" => {
                [&quantity[..], &[("roa:basicData", 0, 1, "BasicData")]].concat()
            }
            "roa:TrafficConcentration" => vec![
                ("roa:measurementOrCalculationTime", 0, 1, "MeasurementOrCalculationTime"),
                ("roa:density", 0, 1, "TrafficDensityValue"),
                ("roa:occupancy", 0, 1, "PercentageValue"),
            ],
            "TrafficDensityValue" => vec![
                ("com:dataError", 0, 1, "boolean"),
                ("com:reasonForDataError", 0, 1, "MultilingualString"),
                ("roa:densityOfVehicles", 1, 1, "nonNegativeInteger"),
            ],
            "PercentageValue" => vec![
                ("com:dataError", 0, 1, "boolean"),
                ("com:reasonForDataError", 0, 1, "MultilingualString"),
                ("com:percentage", 1, 1, "percentage"),
            ],
            "PhysicalQuantityFault" => vec![
                ("com:faultIdentifier", 0, 1, "string"),
                ("com:faultDescription", 0, 1, "MultilingualString"),
                ("com:faultCreationTime", 0, 1, "dateTime"),
                ("com:faultLastUpdateTime", 1, 1, "dateTime"),
                ("roa:physicalQuantityFaultType", 1, 1, "fault"),
            ],
            "MeasurementOrCalculationTime" => vec![
                ("roa:timeMeaning", 0, 1, "timeMeaning"),
                ("roa:timeValue", 0, 1, "dateTime"),
                ("roa:period", 0, 1, "Period"),
            ],
            "Period" => vec![
                ("com:startOfPeriod", 0, 1, "dateTime"),
                ("com:endOfPeriod", 0, 1, "dateTime"),
                ("com:periodName", 0, 1, "MultilingualString"),
            ],
            "MultilingualString" => vec![("com:values", 1, 1, "Values")],
            "Values" => vec![("com:value", 1, MANY, "string")],
            _ => return None,
        })
    }

    fn is_value(kind: &str, text: &str) -> bool {
        match kind {
            "string" => !text.is_empty() && text.len() <= 1024,
            "dateTime" => text.len() == 24 && text.ends_with('Z') && &text[10..11] == "T",
            "boolean" => ["true", "false"].contains(&text),
            "country" => text.len() <= 2 && text.bytes().all(|b| b.is_ascii_alphabetic()),
            "real" => text == "real",
            "float" => text.parse::<f64>().is_ok_and(f64::is_finite),
            "angle" => text.parse::<u32>().is_ok_and(|degrees| degrees < 360),
            "valueType" => ["trafficConcentration", "trafficFlow", "trafficSpeed"].contains(&text),
            "nonNegativeInteger" => text.parse::<u64>().is_ok(),
            "percentage" => text.parse::<f32>().is_ok_and(|p| (0.0..=100.0).contains(&p)),
            "timeMeaning" => ["beginTime", "endTime", "middleTime"].contains(&text),
            "fault" => ["noDataValuesAvailable", "spuriousUnreliableDataValues"].contains(&text),
            _ => panic!("unknown type {kind}"),
        }
    }

    /// Holds an element and all below it against their types; collects names and texts.
    pub fn check(element: &Element, declared: &str, values: &mut Vec<(String, String)>) {
        // The instance names the concrete type.
        let kind = element.attribute("xsi:type").unwrap_or(declared);
        let Some(model) = model(kind) else {
            assert!(element.children.is_empty(), "{}: {kind} has no children", element.name);
            assert!(is_value(kind, &element.text), "{}: {:?}", element.name, element.text);
            values.push((element.name.clone(), element.text.clone()));
            return;
        };
        match kind {
            "Reference" => {
                for attribute in ["targetClass", "id", "version"] {
                    assert!(element.attribute(attribute).is_some(), "{}", element.name);
                }
            }
            "Indexed" => {
                let index = element.attribute("index").and_then(|index| index.parse::<i32>().ok());
                assert!(index.is_some(), "{}", element.name);
            }
            "TrafficDensityValue" => {
                let number = |name| element.attribute(name).and_then(|n| n.parse::<f32>().ok());
                assert!(number("numberOfInputValuesUsed").is_some_and(|n| n.fract() == 0.0));
                assert!(number("standardDeviation").is_some_and(|n| n > 0.0));
                assert!(element.attribute("accuracy").is_none() || number("accuracy") > Some(0.0));
                let quality = number("supplierCalculatedDataQuality");
                assert!(quality.is_some_and(|n| (0.0..=100.0).contains(&n)));
            }
            _ => {}
        }
        assert!(element.text.is_empty(), "{}: {:?}", element.name, element.text);
        let mut children = element.children.iter().peekable();
        for (name, least, most, kind) in model {
            let mut count = 0;
            while let Some(child) = children.next_if(|child| child.name == name) {
                count += 1;
                check(child, kind, values);
            }
            assert!((least..=most).contains(&count), "{}: {count} {name}", element.name);
        }
        let left = children.next().map(|child| &child.name);
        assert_eq!(left, None, "{}: not in the schema, or out of order", element.name);
    }
}

/// As much XML as the output has: elements, attributes, text. Panics on anything else.
mod xml {
    pub struct Element {
        pub name: String,
        pub text: String,
        pub children: Vec<Element>,
        attributes: Vec<(String, String)>,
    }

    impl Element {
        pub fn attribute(&self, name: &str) -> Option<&str> {
            let mut attributes = self.attributes.iter();
            attributes.find(|(key, _)| key == name).map(|(_, value)| value.as_str())
        }
    }

    pub fn parse(document: &str) -> Element {
        let mut rest = document.strip_prefix("<?xml version=\"1.0\" encoding=\"UTF-8\"?>");
        let rest = rest.as_mut().expect("an XML declaration");
        let root = element(rest);
        assert_eq!(rest.trim(), "", "nothing behind the root");
        root
    }

    fn element(rest: &mut &str) -> Element {
        *rest = rest.trim_start().strip_prefix('<').expect("an element");
        let (tag, behind) = rest.split_once('>').expect("the end of a tag");
        *rest = behind;
        let empty = tag.ends_with('/');
        let tag = tag.trim_end_matches('/');
        let (name, attributes) = tag.split_once(' ').unwrap_or((tag, ""));
        let attributes = attributes
            .split_terminator("\" ")
            .map(|pair| pair.split_once("=\"").expect("name and value"))
            .map(|(name, value)| (name.to_owned(), value.trim_end_matches('"').to_owned()))
            .collect();
        let mut found =
            Element { name: name.to_owned(), text: String::new(), children: vec![], attributes };
        if empty {
            return found;
        }
        loop {
            let (text, behind) = rest.split_once('<').expect("an end tag");
            assert!(!text.contains('>'), "{text}");
            found.text += text.trim();
            if let Some(behind) = behind.strip_prefix('/') {
                let (end, behind) = behind.split_once('>').expect("the end of a tag");
                assert_eq!(end, found.name, "elements are nested");
                *rest = behind;
                return found;
            }
            *rest = &rest[text.len()..];
            found.children.push(element(rest));
        }
    }
}
