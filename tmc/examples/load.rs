//! Publishes as many boxes do: one window a minute each, over one connection for a thousand.
//!
//! `cargo run --profile centre -p verge-tmc --example load -- PORT [BOXES [MINUTES]]`, to a broker on
//! this machine. It sends as fast as the broker takes messages and prints the rate; 10,000
//! boxes at one window a minute are 167 messages a second.

use rumqttc::{Client, Event, MqttOptions, Packet, QoS};
use std::fmt::Write;
use std::time::{Duration, Instant};

const BOXES_A_CONNECTION: usize = 1000;
const LANES: usize = 4;

fn main() {
    let numbers: Vec<usize> =
        std::env::args().skip(1).map(|text| text.parse().expect("a number")).collect();
    let port = *numbers.first().expect("the broker's port") as u16;
    let boxes = numbers.get(1).copied().unwrap_or(10_000);
    let minutes = numbers.get(2).copied().unwrap_or(1);
    let begun = Instant::now();
    let senders: Vec<_> = (0..boxes)
        .step_by(BOXES_A_CONNECTION)
        .map(|first| {
            let last = (first + BOXES_A_CONNECTION).min(boxes);
            std::thread::spawn(move || send(port, first..last, minutes))
        })
        .collect();
    for sender in senders {
        sender.join().expect("the broker takes all");
    }
    let (count, seconds) = (boxes * minutes, begun.elapsed().as_secs_f64());
    println!("{count} messages in {seconds:.1} s: {:.0} a second", count as f64 / seconds);
}

fn send(port: u16, boxes: std::ops::Range<usize>, minutes: usize) {
    let mut options = MqttOptions::new(format!("boxes-{}", boxes.start), "127.0.0.1", port);
    options.set_keep_alive(Duration::from_secs(60));
    let (client, mut connection) = Client::new(options, 100);
    let count = boxes.len() * minutes;
    let sender = std::thread::spawn(move || {
        for minute in 0..minutes {
            for number in boxes.clone() {
                let topic = format!("verge/box{number:05}/density/60s");
                let payload = message(number, minute);
                client.publish(topic, QoS::AtLeastOnce, false, payload).expect("a connection");
            }
        }
        client
    });
    let mut acknowledged = 0;
    while acknowledged < count {
        match connection.recv_timeout(Duration::from_secs(60)).expect("an answer in a minute") {
            Ok(Event::Incoming(Packet::PubAck(_))) => acknowledged += 1,
            Ok(_) => {}
            Err(error) => panic!("{error}"),
        }
    }
    // The connection ends with its client.
    drop(sender.join());
}

fn message(number: usize, minute: usize) -> String {
    let mut lanes = String::new();
    for lane in 1..=LANES {
        let comma = if lane > 1 { "," } else { "" };
        // Writing to a string does not fail.
        let _ = write!(
            lanes,
            "{comma}{{\"lane\":{lane},\"direction\":\"away\",\"density_veh_km\":{}.25,\
             \"density_se\":1.5,\"vehicles_mean\":1.2,\"by_class\":null,\"space_occupancy\":0.05,\
             \"length_m\":100.0,\"frames_used\":30,\"frames_expected\":30,\"status\":\"oK\"}}",
            (number + minute + lane) % 90
        );
    }
    // From yesterday on, for the archive takes none that is to come.
    const DAY_MS: i64 = 86_400_000;
    let now_ms = jiff::Timestamp::now().as_millisecond();
    let begin_ms = now_ms - now_ms.rem_euclid(DAY_MS) - DAY_MS;
    let time = |minute: usize| verge_messages::rfc3339(begin_ms + minute as i64 * 60_000);
    let (from, to, sha256) = (time(minute), time(minute + 1), "0".repeat(64));
    format!(
        "{{\"schema\":1,\"site\":\"box{number:05}\",\"seq\":{},\"window_s\":60,\
         \"from\":\"{from}\",\"to\":\"{to}\",\
         \"clock_synced\":true,\"lanes\":[{lanes}],\"calibration\":{{\"id\":\"a\",\
         \"sha256\":\"{sha256}\",\"rel_err\":0.02}},\"model\":{{\"name\":\"m\",\"sha256\":\"{sha256}\"}}}}",
        minute + 1
    )
}
