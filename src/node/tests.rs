//! The node as its serial line and its flash see it: bytes and time in, pins out.

use super::link::{MAX_ENCODED, Receiver, encode};
use super::protocol::{read_answer, write_request};
use super::store::{SLOT_LEN, Slots, Stored};
use super::*;
use crate::density::SampleZoneStatus;
use crate::lane::Name;
use crate::units::LaneId;
use crate::wire::tests as wired;
use crate::wire::{DensityMessage, MAX_DENSITY_MESSAGE};
use embedded_storage::nor_flash::{
    ErrorType, NorFlash, NorFlashError, NorFlashErrorKind, ReadNorFlash,
};
use std::vec::Vec;

/// Flash whose power can fail before any byte that it erases or writes.
#[derive(Clone, Debug)]
struct MockFlash {
    bytes: Vec<u8>,
    bytes_until_cut: usize,
}

#[derive(Debug)]
struct PowerCut;

impl NorFlashError for PowerCut {
    fn kind(&self) -> NorFlashErrorKind {
        NorFlashErrorKind::Other
    }
}

impl MockFlash {
    fn new() -> Self {
        Self { bytes: [0xFF; 2 * 512].to_vec(), bytes_until_cut: usize::MAX }
    }

    fn change(&mut self, at: usize, by: impl Fn(u8) -> u8) -> Result<(), PowerCut> {
        self.bytes_until_cut = self.bytes_until_cut.checked_sub(1).ok_or(PowerCut)?;
        self.bytes[at] = by(self.bytes[at]);
        Ok(())
    }
}

impl ErrorType for MockFlash {
    type Error = PowerCut;
}

impl ReadNorFlash for MockFlash {
    const READ_SIZE: usize = 1;
    fn read(&mut self, offset: u32, bytes: &mut [u8]) -> Result<(), PowerCut> {
        bytes.copy_from_slice(&self.bytes[offset as usize..offset as usize + bytes.len()]);
        Ok(())
    }
    fn capacity(&self) -> usize {
        self.bytes.len()
    }
}

impl NorFlash for MockFlash {
    const WRITE_SIZE: usize = 4;
    const ERASE_SIZE: usize = 512;
    fn erase(&mut self, from: u32, to: u32) -> Result<(), PowerCut> {
        assert!(from.is_multiple_of(512) && to.is_multiple_of(512));
        (from..to).try_for_each(|at| self.change(at as usize, |_| 0xFF))
    }
    fn write(&mut self, offset: u32, bytes: &[u8]) -> Result<(), PowerCut> {
        assert!(offset.is_multiple_of(4) && bytes.len().is_multiple_of(4));
        let places = offset as usize..;
        places.zip(bytes).try_for_each(|(at, &byte)| self.change(at, |old| old & byte))
    }
}

fn lane(number: u8) -> LaneId {
    LaneId::new(number).expect("a lane's number")
}

fn output(on_veh_km: f32, off_veh_km: f32) -> Output {
    Output { lane: lane(1), on_veh_km, off_veh_km, least_on_s: 0, fail_safe: true }
}

/// A node whose output 1 follows lane 1: on at 40, off at 30 veh/km, fail-safe closed after 90 s.
fn settings() -> Settings {
    let mut settings = Settings { hold_s: 90, ..Settings::default() };
    settings.outputs[0] = Some(output(40.0, 30.0));
    settings
}

/// A message whose every lane has `density_veh_km`.
fn reading(seq: u64, density_veh_km: Option<f32>, status: SampleZoneStatus) -> DensityMessage {
    let mut report = wired::lane(1, density_veh_km);
    report.status = status;
    DensityMessage { seq, ..wired::message(&[report]) }
}

fn on_the_line(content: &[u8]) -> Vec<u8> {
    let mut line = [0; MAX_ENCODED];
    encode(content, &mut line).expect("it fits").to_vec()
}

fn message_on_the_line(message: &DensityMessage) -> Vec<u8> {
    let mut buffer = [0; MAX_DENSITY_MESSAGE];
    on_the_line(wire::encode(message, &mut buffer).expect("it fits"))
}

fn ask<F: NorFlash>(node: &mut Node<F>, now: Duration, request: &Request) -> Answer {
    let mut buffer = [0; 512];
    let bytes = on_the_line(write_request(request, &mut buffer).expect("it fits"));
    let answers: Vec<_> = bytes.into_iter().filter_map(|byte| node.byte(now, byte)).collect();
    let [answer] = answers.as_slice() else { panic!("one answer, not {answers:?}") };
    let answer_bytes = super::protocol::write_answer(answer, &mut buffer).expect("it fits");
    assert!(answer_bytes.len() + 4 < MAX_ANSWER, "an answer of {} bytes", answer_bytes.len());
    read_answer(answer_bytes).expect("it reads back")
}

fn counters<F: NorFlash>(node: &mut Node<F>) -> Counters {
    match ask(node, Duration::ZERO, &Request::Counters) {
        Answer::Counters(counters) => counters,
        other => panic!("{other:?}"),
    }
}

fn seconds(s: u64) -> Duration {
    Duration::from_secs(s)
}

/// An event, and output 1's state right after it.
enum Step {
    Density(f32, bool),
    Null(bool),
    Status(SampleZoneStatus, f32, bool),
    Wait(bool),
}

fn run(settings: Settings, steps: &[(u64, Step)]) {
    let mut outputs = Outputs::new(settings);
    for (seq, (at_s, step)) in (1..).zip(steps) {
        let mut hear = |density, status| {
            outputs.hear(seconds(*at_s), &reading(seq, density, status));
        };
        let closed = match *step {
            Step::Density(density, closed) => {
                hear(Some(density), SampleZoneStatus::Ok);
                closed
            }
            Step::Null(closed) => {
                hear(None, SampleZoneStatus::Ok);
                closed
            }
            Step::Status(status, density, closed) => {
                hear(Some(density), status);
                closed
            }
            Step::Wait(closed) => closed,
        };
        assert_eq!(outputs.pins(seconds(*at_s)), u8::from(closed), "at {at_s} s");
    }
}

#[test]
fn hysteresis_and_the_fail_safe_state() {
    use Step::{Density, Null, Status, Wait};
    run(
        settings(),
        &[
            (0, Wait(true)),
            (10, Density(35.0, true)),
            (20, Density(30.0, false)),
            (30, Density(39.9, false)),
            (40, Density(40.0, true)),
            (50, Density(30.1, true)),
            (60, Density(29.0, false)),
            // Unusable messages do not count, and keep nothing alive.
            (70, Null(false)),
            (80, Status(SampleZoneStatus::DetectionAutoSuspended, 90.0, false)),
            (90, Density(f32::NAN, false)),
            (100, Density(-1.0, false)),
            (149, Wait(false)),
            (150, Wait(true)),
            (151, Density(10.0, false)),
        ],
    );
}

#[test]
fn once_closed_an_output_stays_for_its_least_time() {
    use Step::{Density, Wait};
    let mut with_least = settings();
    with_least.outputs[0] = Some(Output { least_on_s: 60, fail_safe: false, ..output(40.0, 30.0) });
    run(
        with_least,
        &[
            (0, Wait(false)),
            (10, Density(50.0, true)),
            (20, Density(10.0, true)),
            (69, Wait(true)),
            (70, Wait(false)),
            // The fail-safe state comes at once.
            (80, Density(50.0, true)),
            (169, Wait(true)),
            (170, Wait(false)),
        ],
    );
}

#[test]
fn a_sender_that_hangs_keeps_nothing_fresh() {
    let mut node = Node::start(MockFlash::new());
    ask(&mut node, Duration::ZERO, &Request::Set(settings()));
    let bytes = message_on_the_line(&reading(1, Some(10.0), SampleZoneStatus::Ok));
    for at_s in 0..=90 {
        for &byte in &bytes {
            node.byte(seconds(at_s), byte);
        }
        assert_eq!(node.pins(seconds(at_s)), u8::from(at_s == 90), "at {at_s} s");
    }
    let counted = counters(&mut node);
    assert_eq!((counted.messages, counted.repeated), (1, 90));
}

#[test]
fn other_sites_and_windows_are_counted_and_not_used() {
    let mut set = settings();
    set.site = Name::try_from("elsewhere").expect("short");
    let mut outputs = Outputs::new(set.clone());
    let message = reading(1, Some(10.0), SampleZoneStatus::Ok);
    assert_eq!(outputs.hear(seconds(1), &message), Heard::OtherSite);
    set.site = message.site.clone();
    set.window_s = 7;
    outputs.replace(seconds(1), set);
    assert_eq!(outputs.hear(seconds(1), &message), Heard::OtherWindow);
    assert_eq!(outputs.pins(seconds(1)), 1, "nothing was heard: fail-safe");
}

#[test]
fn settings_are_checked_answered_and_kept() {
    let mut node = Node::start(MockFlash::new());
    assert_eq!(node.pins(Duration::ZERO), 0, "nothing is set: every output is open");
    let good = settings();
    let set = |settings: &Settings| Request::Set(settings.clone());
    let kept = |sequence| Answer::Settings { sequence, settings: good.clone() };
    assert_eq!(ask(&mut node, Duration::ZERO, &set(&good)), kept(1));
    let with = |change: fn(&mut Settings)| {
        let mut settings = good.clone();
        change(&mut settings);
        settings
    };
    for (bad, reason) in [
        (with(|s| s.hold_s = 0), SettingsError::Hold),
        (with(|s| (s.hold_s, s.window_s) = (60, 60)), SettingsError::Hold),
        (
            with(|s| s.outputs[7] = Some(output(30.0, 30.0))),
            SettingsError::NoHysteresis { output: 8 },
        ),
        (
            with(|s| s.outputs[1] = Some(output(f32::NAN, 3.0))),
            SettingsError::Threshold { output: 2 },
        ),
        (with(|s| s.outputs[1] = Some(output(30.0, -1.0))), SettingsError::Threshold { output: 2 }),
        (
            with(|s| s.outputs[0] = Some(Output { least_on_s: 9999, ..output(9.0, 3.0) })),
            SettingsError::LeastOn { output: 1 },
        ),
    ] {
        assert_eq!(ask(&mut node, Duration::ZERO, &set(&bad)), Answer::Refused(reason));
        assert_eq!(ask(&mut node, Duration::ZERO, &Request::Settings), kept(1));
    }
    let Node { slots, .. } = node;
    let mut node = Node::start(slots.into_flash());
    assert_eq!(ask(&mut node, Duration::ZERO, &Request::Settings), kept(1), "after a restart");
    assert_eq!(counters(&mut node).slots_damaged, 0);
}

#[test]
fn a_power_cut_at_every_byte_of_a_write_keeps_the_older_settings() {
    let mut flash = MockFlash::new();
    let numbered = |lane_number| {
        let mut settings = settings();
        settings.outputs = [Some(Output { lane: lane(lane_number), ..output(40.0, 30.0) }); 8];
        settings
    };
    for generation in 1..=4 {
        let before = (generation > 1).then(|| numbered(generation - 1));
        let mut cuts = 0;
        for cut in 0.. {
            let mut slots = Slots::new(MockFlash { bytes_until_cut: cut, ..flash.clone() });
            slots.load();
            if slots.save(&numbered(generation)).is_ok() {
                flash = MockFlash { bytes_until_cut: usize::MAX, ..slots.into_flash() };
                break;
            }
            cuts += 1;
            let cut_flash = MockFlash { bytes_until_cut: usize::MAX, ..slots.into_flash() };
            match (Slots::new(cut_flash.clone()).load(), &before) {
                (Stored::Settings { settings, .. }, Some(before)) if settings == *before => {}
                // Only the last bytes were missing, and they are those of erased flash.
                (Stored::Settings { settings, .. }, _) if settings == numbered(generation) => {}
                (Stored::Blank | Stored::Lost, None) => {}
                (other, _) => panic!("cut after {cut} bytes of write {generation}: {other:?}"),
            }
            // And the next write succeeds.
            let mut slots = Slots::new(cut_flash);
            slots.load();
            slots.save(&numbered(generation)).expect("power is back");
            assert!(
                matches!(slots.load(), Stored::Settings { settings, .. } if settings == numbered(generation))
            );
        }
        assert!(cuts > 512, "a block to erase, and the settings");
    }
}

#[test]
fn lost_settings_close_every_output() {
    let mut flash = MockFlash::new();
    flash.bytes[..2 * SLOT_LEN].fill(0x5A);
    flash.bytes[512..].fill(0x5A);
    let mut node = Node::start(flash);
    assert_eq!(node.pins(seconds(1)), u8::MAX);
    assert_eq!(counters(&mut node).slots_damaged, 1);
    ask(&mut node, seconds(1), &Request::Set(settings()));
    assert_eq!(node.pins(seconds(1)), 1, "only output 1 is set");
}

#[test]
fn the_counter_of_writes_may_wrap() {
    let mut flash = MockFlash::new();
    let mut slots = Slots::new(flash.clone());
    slots.save(&settings()).expect("it is kept");
    flash = slots.into_flash();
    // Sequence u32::MAX, with the checksum that belongs to it.
    let len = 10 + usize::from(u16::from_le_bytes([flash.bytes[8], flash.bytes[9]]));
    flash.bytes[4..8].fill(0xFF);
    let crc = wire::CRC.checksum(&flash.bytes[..len]).to_le_bytes();
    flash.bytes[len..len + 4].copy_from_slice(&crc);
    let mut slots = Slots::new(flash);
    slots.load();
    let mut other = settings();
    other.hold_s = 77;
    assert_eq!(slots.save(&other), Ok(0));
    let mut slots = Slots::new(slots.into_flash());
    assert!(matches!(slots.load(), Stored::Settings { settings, .. } if settings == other));
}

/// Garbage, cut and flipped frames, and now and then a whole message: the pins must be those
/// of a node that heard the whole messages alone.
#[test]
fn fuzzed_bytes_never_move_an_output() {
    let long = std::env::var_os("VERGE_LONG").is_some();
    let bytes_wanted = if long { 10_000_000 } else { 400_000 };
    let mut random = 0x9E37_79B9_7F4A_7C15_u64;
    let mut next = move |below: u64| {
        // xorshift64 (Marsaglia 2003).
        random ^= random << 13;
        random ^= random >> 7;
        random ^= random << 17;
        random % below
    };
    let mut node = Node::start(MockFlash::new());
    ask(&mut node, Duration::ZERO, &Request::Set(settings()));
    let mut oracle = Outputs::new(settings());
    let (mut now, mut fed, mut seq) = (Duration::ZERO, 0, 0);
    let mut refused = 0u32;
    while fed < bytes_wanted {
        seq += 1;
        now += Duration::from_millis(next(30_000));
        let truth = reading(seq, Some(next(80) as f32), SampleZoneStatus::Ok);
        let mut bytes = message_on_the_line(&truth);
        let kind = next(4);
        match kind {
            0 => {
                oracle.hear(now, &truth);
            }
            1 => {
                let at = 1 + next(bytes.len() as u64 - 2) as usize;
                bytes[at] ^= 1 << next(8);
            }
            2 => bytes.truncate(1 + next(bytes.len() as u64 - 2) as usize),
            _ => bytes = (0..next(600)).map(|_| next(256) as u8).collect(),
        }
        // Each begins with a zero, so that one's end cannot be another's beginning.
        bytes.insert(0, 0);
        bytes.push(0);
        for &byte in &bytes {
            assert_eq!(node.byte(now, byte), None, "nothing was asked");
        }
        fed += bytes.len();
        refused += u32::from(kind != 0);
        assert_eq!(node.pins(now), oracle.pins(now), "after {fed} bytes, kind {kind}");
    }
    let counted = counters(&mut node);
    assert_eq!(counted.messages, seq as u32 - refused);
    assert!(counted.checksum > 0 && counted.framing > 0);
}

#[test]
fn a_receiver_needs_no_more_than_it_says() {
    assert!(size_of::<Receiver>() <= MAX_DENSITY_MESSAGE + 32);
}
