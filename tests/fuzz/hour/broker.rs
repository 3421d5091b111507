//! A broker that misbehaves under MQTT 5, in another way every few seconds, and comes to itself in
//! the end: then all windows are there.

use super::fake_broker::{FakeBroker, Manners};
use super::{Watched, common, is_long, mutate};
use fastrand::Rng;
use std::collections::BTreeSet;
use std::time::{Duration, Instant};

/// Most memory that the daemon may take, MB.
const BOUND_MB: f64 = 64.0;
/// A topic that is set aside is tried again after 15 minutes.
const PATIENCE: Duration = Duration::from_secs(25 * 60);

/// Packets that a broker may send (MQTT 5), well made.
fn packets() -> Vec<Vec<u8>> {
    let publish = |first: u8, length: usize| {
        let mut packet = vec![first];
        let rest = 2 + 1 + if first & 6 > 0 { 2 } else { 0 } + 1 + length;
        packet.extend([(rest % 128) as u8 | 0x80, (rest / 128) as u8]);
        packet.extend(b"\0\x01t");
        if first & 6 > 0 {
            packet.extend(b"\x01\x02");
        }
        packet.push(0);
        packet.extend(std::iter::repeat_n(b'x', length));
        packet
    };
    vec![
        b"\x20\x03\0\0\0".to_vec(),
        b"\x20\x13\x01\0\x10\x21\0\x01\x22\xff\xff\x27\0\0\0\xff\x24\0\x25\0\x13\0\x01".to_vec(),
        b"\x20\x0f\0\x87\x0c\x1f\0\x09\x1b[2Jdenied".to_vec(),
        publish(0x30, 1000),
        publish(0x32, 500),
        publish(0x34, 500),
        b"\x30\x0b\0\x01t\x03\x23\0\x07hello".to_vec(),
        b"\x40\x02\0\x01".to_vec(),
        b"\x40\x04\0\x02\x97\0".to_vec(),
        b"\x50\x02\0\x01".to_vec(),
        b"\x62\x02\0\x01".to_vec(),
        b"\x70\x02\0\x01".to_vec(),
        b"\x90\x04\0\x01\0\x01".to_vec(),
        b"\xb0\x04\0\x01\0\0".to_vec(),
        b"\xd0\0".to_vec(),
        b"\xe0\x02\x8e\0".to_vec(),
        b"\xf0\x02\x18\0".to_vec(),
        b"\x30\xff\xff\xff\x7f\0\x01t\0".to_vec(),
    ]
}

/// Words of MQTT 5: lengths and properties.
const WORDS: &[&[u8]] = &[
    b"\xff\xff\xff\x7f",
    b"\x80\x80\x80\x80\x01",
    b"\x26\0\x01a\0\x01b",
    b"\x23\xff\xff",
    b"\x21\0\0",
    b"\x27\0\0\0\0",
    b"\x0b\x01",
    b"\0\0",
    b"\xff\xff",
];

fn manners(rng: &mut Rng) -> Manners {
    let polite = Manners { versions: vec![5], ..Manners::default() };
    let parts = ["density/", "presence", "health", "alarm", "/"];
    let part = parts[rng.usize(..parts.len())];
    match rng.u8(..14) {
        0 => Manners { refuses: Some(0x80 | rng.u8(..)), ..polite },
        1 => Manners { closes_on: Some(part), ..polite },
        2 => Manners { closes_from: Some(rng.usize(20..2000)), ..polite },
        3 => Manners { ignores: Some(part), ..polite },
        4 => Manners { reason: Some((part, rng.u8(..))), ..polite },
        5 => Manners { ends_after: Some(1), ..polite },
        6 => {
            let limits: &[&[u8]] = &[
                b"\x21\0\x01",
                b"\x21\0\0",
                b"\x27\0\0\0\x40",
                b"\x27\0\0\0\0",
                b"\x24\0",
                b"\x25\0",
                b"\x13\0\x01",
                b"\x12\xff\xff",
                b"\x1f\0\x05\x1b[2J\n",
                b"\x22\xff\xff",
                b"\x99",
            ];
            let properties = limits[rng.usize(..limits.len())].to_vec();
            Manners { properties, ..polite }
        }
        7 => polite,
        _ => {
            let corpus = packets();
            let many = (0..rng.usize(1..20)).flat_map(|_| match rng.bool() {
                true => corpus[rng.usize(..corpus.len())].clone(),
                false => mutate::mutated(rng, &corpus, WORDS, 4096),
            });
            let flood = Some(many.collect()).filter(|flood: &Vec<u8>| !flood.is_empty());
            Manners { flood, flood_pause: Duration::from_millis(50), ..polite }
        }
    }
}

/// The numbers of the ten-second windows that it has taken.
fn numbers(broker: &FakeBroker) -> BTreeSet<u64> {
    broker.seen(|seen| {
        let windows = seen
            .taken
            .iter()
            .filter(|(topic, payload)| topic.ends_with("density/10s") && !payload.is_empty());
        let number = |payload: &[u8]| {
            serde_json::from_slice::<serde_json::Value>(payload).ok()?["seq"].as_u64()
        };
        windows.filter_map(|(_, payload)| number(payload)).collect()
    })
}

#[test]
fn a_broker_may_misbehave() {
    let broker = FakeBroker::start(Manners::default());
    let here = std::env::current_dir().expect("a folder");
    let here = here.display();
    let sections = format!(
        "[camera]\nid = \"curve\"\ninterval_s = 2\nwatch = false\nsource = \"{here}/{}\"\n\
         [model]\nfile = \"{here}/{}\"\n[lane_table]\nfile = \"{here}/{}\"\n\
         [windows]\nlengths_s = [10, 60]\n[mqtt]\nport = {}\nkeep_alive_s = 5\n",
        common::STREET_FRAMES,
        common::MODEL,
        common::STREET_TABLE,
        broker.port
    );
    let mut rng = Rng::with_seed(5);
    let mut next = Duration::from_millis(500);
    let mut daemon = Watched::start("under a broker", &sections, |_| ());
    daemon.wait_for(&broker);
    daemon.watch(BOUND_MB, |elapsed| {
        if elapsed >= next {
            next =
                elapsed + Duration::from_secs_f64(rng.f64() * if is_long() { 40.0 } else { 2.0 });
            broker.change(manners(&mut rng));
            if rng.bool() {
                broker.hang_up();
            }
        }
    });
    println!("{} connections", broker.connections());
    broker.change(Manners::default());
    broker.hang_up();
    if is_long() {
        let begun = Instant::now();
        let is_complete = |seen: &BTreeSet<u64>| {
            let last = seen.last().copied().unwrap_or_default();
            last >= 300 && seen.len() as u64 == last
        };
        while !is_complete(&numbers(&broker)) {
            let seen = numbers(&broker);
            assert!(begun.elapsed() < PATIENCE, "{} windows, to {:?}", seen.len(), seen.last());
            std::thread::sleep(Duration::from_secs(1));
        }
        println!("{} windows, none missing, {:?} later", numbers(&broker).len(), begun.elapsed());
    }
}
