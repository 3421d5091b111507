//! A thousand boxes at a broker that comes back, each with a connection of its own.

use super::{common, is_long};
use common::mosquitto::{Mosquitto, Running};
use std::io::{BufRead, BufReader};
use std::process::{Command, Stdio};
use std::sync::mpsc::{self, Receiver};
use std::time::{Duration, Instant};
use verge::daemon::publish::{Format, MqttSettings, Publisher};
use verge_desk::free_port;

const BOXES: usize = 1000;
/// Ceilings of the waits have come to their end by then.
const OUTAGE: Duration = Duration::from_secs(150);
/// The longest wait, and an attempt.
const RETURN: Duration = Duration::from_secs(75);
/// Over which the rate of attempts is taken: the mean is some 80 in it.
const BIN_S: f64 = 5.0;

/// Starts a broker that says each attempt at a connection.
fn start_broker(port: u16, folder: &std::path::Path) -> (Running, Receiver<Instant>) {
    let config = folder.join("mosquitto.conf");
    let text = format!(
        "listener {port} 127.0.0.1\nallow_anonymous true\nlog_dest stderr\nlog_type notice\n"
    );
    std::fs::write(&config, text).expect("writing it");
    let mut broker = Command::new("/usr/sbin/mosquitto")
        .arg("-c")
        .arg(&config)
        .stderr(Stdio::piped())
        .spawn()
        .map(Running)
        .expect("mosquitto starts");
    let log = BufReader::new(broker.0.stderr.take().expect("piped"));
    let (sender, attempts) = mpsc::channel();
    std::thread::spawn(move || {
        for line in log.lines().map_while(Result::ok) {
            if line.contains("New connection from") && sender.send(Instant::now()).is_err() {
                return;
            }
        }
    });
    (broker, attempts)
}

/// Tends all boxes until so many have a session, or the time is up; returns how many have.
fn tend(boxes: &mut [Publisher], until: Instant, enough: usize) -> usize {
    loop {
        for publisher in boxes.iter_mut() {
            while publisher.delivery().is_some() {}
        }
        let open = boxes.iter().filter(|publisher| publisher.is_open()).count();
        if open == enough || Instant::now() > until {
            return open;
        }
        std::thread::sleep(Duration::from_millis(20));
    }
}

#[test]
fn a_thousand_boxes_return_at_no_more_than_twice_the_mean_rate() {
    // Ten minutes and a thousand sockets.
    if !is_long() || Mosquitto::installed().is_none() {
        return;
    }
    let (folder, port) = (common::folder(), free_port());
    let (mut broker, _first) = start_broker(port, folder.path());
    let mut boxes: Vec<_> = (0..BOXES)
        .map(|n| {
            Publisher::start(MqttSettings::local(port, &format!("verge/box{n}")), Format::Json)
        })
        .collect();
    let patience = Duration::from_secs(180);
    assert_eq!(tend(&mut boxes, Instant::now() + patience, BOXES), BOXES);
    let rounds = 3;
    let (mut bins, mut rate) = (vec![0.0; 16], 0.0);
    for _ in 0..rounds {
        broker.kill();
        assert_eq!(tend(&mut boxes, Instant::now() + OUTAGE, usize::MAX), 0);
        let back = Instant::now();
        let (again, attempts) = start_broker(port, folder.path());
        broker = again;
        assert_eq!(tend(&mut boxes, back + RETURN, BOXES), BOXES, "all are back");
        let times: Vec<_> =
            attempts.try_iter().map(|at| at.duration_since(back).as_secs_f64()).collect();
        assert_eq!(times.len(), BOXES, "one attempt each is enough");
        let last = times.iter().copied().fold(0.0, f64::max);
        let mut of_round = vec![0.0_f64; bins.len()];
        times.iter().for_each(|time| of_round[(time / BIN_S) as usize] += 1.0 / BIN_S);
        let (peak, mean) = (of_round.iter().copied().fold(0.0, f64::max), BOXES as f64 / last);
        println!(
            "{BOXES} boxes back in {last:.0} s: {peak:.1} attempts a second at most, {mean:.1} on average: {:.2}",
            peak / mean
        );
        bins.iter_mut().zip(&of_round).for_each(|(sum, one)| *sum += one);
        rate += mean;
    }
    let ratio = bins.into_iter().fold(0.0, f64::max) / rate;
    println!("{rounds} times together: {ratio:.2}");
    assert!(ratio <= 2.1, "2.0 is what is expected of full jitter, with its own chance: {ratio}");
}
