//! Messages that are read back: wire format and JSON.

use super::files::small_table;
use super::runner::Target;
use super::{CRC, mend_trailer, outcome, windows};
use verge::daemon::publish::payload;
use verge::density::SampleZoneStatus;
use verge::wire::{self, DensityMessage};
use verge_messages::formats::{Exporter, Format, Publisher};
use verge_messages::{Density, Status, read};

/// A message's outcome: its lanes, and what is known of them.
fn message_kind(message: &Density) -> String {
    let known = |lane: &verge_messages::Lane| {
        let is_known = [
            lane.density_veh_km.is_some(),
            lane.by_class.is_some(),
            lane.space_occupancy.is_some(),
            lane.cells.as_ref().is_some_and(|cells| cells.density_veh_km.is_some()),
            lane.status == Status::Ok,
        ];
        is_known.map(|known| if known { 'k' } else { '-' }).iter().collect::<String>()
    };
    message.lanes.iter().map(known).collect::<Vec<_>>().join("/")
}

/// Messages with and without density.
pub fn messages_to_begin_with() -> Vec<DensityMessage> {
    windows::messages(small_table(10.0, None), "site", SampleZoneStatus::PoorContrast)
}

/// Writes a message that was read in every format: none of it may panic.
fn export(message: &Density) {
    for format in Format::ALL {
        let text = Exporter::new(format, Publisher::default()).message(message);
        // A table of sites asks for a position.
        assert!(text.map_or_else(|reason| !reason.is_empty(), |text| !text.is_empty()));
    }
}

/// The message as the first verge wrote it: without cells and errors.
fn format_1(message: &DensityMessage) -> Vec<u8> {
    let mut message = message.clone();
    message.report.lanes.iter_mut().for_each(|lane| (lane.cells, lane.error) = (None, None));
    let mut buffer = [0; wire::MAX_MESSAGE];
    let bytes = wire::encode(&message, &mut buffer).expect("fits");
    // Behind the body stand two zeros for each lane, and the checksum.
    let body = &bytes[1..bytes.len() - 4 - 2 * message.report.lanes.len()];
    let mut old = [&[1], body].concat();
    old.extend_from_slice(&CRC.checksum(&old).to_le_bytes());
    assert_eq!(wire::decode(&old).as_ref(), Ok(&message));
    old
}

#[test]
fn wire_messages() {
    let mut buffer = [0; wire::MAX_MESSAGE];
    let encoded = |message| wire::encode(message, &mut buffer).expect("fits").to_vec();
    let messages = messages_to_begin_with();
    let mut corpus: Vec<_> = messages.iter().map(encoded).collect();
    corpus.extend(messages.iter().map(format_1));
    let target = Target {
        name: "wire_messages",
        executions: 50_000,
        corpus,
        tokens: &[
            b"\xff\xff\xff\xff\xff\xff\xff\xff\xff\x01",
            b"\x80\x80\x80\x80\x10",
            b"\0\0\xc0\x7f",
            b"\0\0\x80\x7f",
            b"\0\0\x80\xff",
            b"\xc3\x28",
        ],
        longest: 2 * wire::MAX_MESSAGE,
    };
    let mut buffer = [0; 4 * wire::MAX_MESSAGE];
    target.run(|rng, input| {
        mend_trailer(rng, input);
        let result = wire::decode(input);
        if let Ok(message) = &result {
            let bytes = wire::encode(message, &mut buffer).expect("what was read can be written");
            assert!(bytes.len() <= wire::MAX_MESSAGE, "{} bytes", bytes.len());
            let density = verge::messages::density(message, None);
            // A message that passes the check is written in every format, and read back.
            if density.check().is_ok() {
                export(&density);
                assert_eq!(read(&verge_messages::json(&density)).as_ref(), Ok(&density));
            }
        }
        outcome(result, |message| message_kind(&verge::messages::density(&message, None)))
    });
}

#[test]
fn json_messages() {
    let target = Target {
        name: "json_messages",
        executions: 10_000,
        corpus: messages_to_begin_with().iter().map(|m| payload::density(m, None)).collect(),
        tokens: &[
            b"null",
            b"-1",
            b"1e999",
            b"1e-999",
            b"NaN",
            b"{",
            b"}",
            b"[",
            b"]",
            b"[[[[[[[[",
            b"\"schema\":1",
            b"\"lanes\":[",
            b"\"oK\"",
            b"\\u0000",
            b"\\ud800",
            b"\xc3\x28",
            b"9999-12-31T23:59:59.999Z",
            b"-009999-01-01T00:00:00Z",
            b"1e30",
            b"3.5e38",
        ],
        longest: 1 << 14,
    };
    target.run(|_, input| {
        let result = read(input);
        if let Ok(message) = &result {
            export(message);
            assert_eq!(read(&verge_messages::json(message)).as_ref(), Ok(message));
        }
        outcome(result, |message| message_kind(&message))
    });
}
