//! Privacy: numbers to the broker leave the box, and nothing else. No picture, no other
//! connection, no socket that listens.
#![cfg(all(feature = "demo", target_os = "linux"))]

mod common;

use std::collections::BTreeSet;
use std::fs;
use std::io::{Read, Write};
use std::net::{Ipv4Addr, Shutdown, TcpListener, TcpStream};
use std::process::{Child, Command, Stdio};
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};
use verge::daemon::publish::loopback::{self, Subscriber};
use verge::daemon::publish::payload;
use verge::density::{
    Cells, DensityError, LaneReport, MAX_LANE_CELLS, SampleZoneStatus, WindowReport,
};
use verge::lane::{MAX_NAME, Name};
use verge::units::{Direction, LaneId, MAX_LANES, UtcMs, VehicleClass};
use verge::wire::{CalibrationRef, DensityMessage, ModelRef};

/// A debug build on a busy machine needs most of it to load its model.
const PATIENCE: Duration = Duration::from_secs(120);

/// Passes connections on to the broker and keeps what the daemon sends. Returns its port.
fn proxy(broker: u16, sent: Arc<Mutex<Vec<u8>>>) -> u16 {
    let listener = TcpListener::bind((Ipv4Addr::LOCALHOST, 0)).expect("a free port");
    let port = listener.local_addr().expect("its address").port();
    std::thread::spawn(move || {
        for daemon in listener.incoming().map_while(Result::ok) {
            let there = TcpStream::connect((Ipv4Addr::LOCALHOST, broker)).expect("the broker");
            let (answers, back) = (there.try_clone(), daemon.try_clone());
            let (mut answers, mut back) = (answers.expect("a copy"), back.expect("a copy"));
            std::thread::spawn(move || {
                let _ = std::io::copy(&mut answers, &mut back);
                let _ = back.shutdown(Shutdown::Both);
            });
            pass_on(daemon, there, &sent);
        }
    });
    port
}

fn pass_on(mut daemon: TcpStream, mut broker: TcpStream, sent: &Mutex<Vec<u8>>) {
    let mut buffer = [0; 4096];
    while let Ok(count @ 1..) = daemon.read(&mut buffer) {
        let bytes = &buffer[..count];
        sent.lock().expect("nobody panics with it").extend_from_slice(bytes);
        if broker.write_all(bytes).is_err() {
            break;
        }
    }
    let _ = broker.shutdown(Shutdown::Both);
}

/// The payloads of all MQTT PUBLISH packets in a client's stream, with their topics.
fn published(mut stream: &[u8]) -> Vec<(String, Vec<u8>)> {
    fn take<'a>(bytes: &mut &'a [u8], count: usize) -> &'a [u8] {
        let (head, tail) = bytes.split_at_checked(count).expect("whole packets");
        *bytes = tail;
        head
    }
    fn variable(bytes: &mut &[u8]) -> usize {
        let (mut value, mut shift) = (0, 0);
        loop {
            let byte = take(bytes, 1)[0];
            value |= usize::from(byte & 0x7f) << shift;
            shift += 7;
            if byte & 0x80 == 0 {
                return value;
            }
        }
    }
    fn text(bytes: &mut &[u8]) -> String {
        let len = take(bytes, 2);
        let len = usize::from(len[0]) << 8 | usize::from(len[1]);
        String::from_utf8(take(bytes, len).to_vec()).expect("text")
    }
    let mut messages = Vec::new();
    let mut level = 0;
    while !stream.is_empty() {
        let kind = take(&mut stream, 1)[0];
        let len = variable(&mut stream);
        let mut packet = take(&mut stream, len);
        match kind >> 4 {
            1 => {
                assert_eq!(text(&mut packet), "MQTT");
                level = packet[0];
            }
            3 => {
                let topic = text(&mut packet);
                if kind & 0b110 != 0 {
                    take(&mut packet, 2);
                }
                if level == 5 {
                    let properties = variable(&mut packet);
                    take(&mut packet, properties);
                }
                messages.push((topic, packet.to_vec()));
            }
            _ => {}
        }
    }
    messages
}

/// The largest density message that there can be, in JSON.
fn largest_message() -> usize {
    let name = Name::try_from("\"".repeat(MAX_NAME).as_str()).expect("fits");
    let number = Some(1.234_567_8e38);
    let lanes = (1..=MAX_LANES as u8).map(|lane| LaneReport {
        lane: LaneId::new(lane).expect("in range"),
        direction: Direction::Unknown,
        density_veh_km: number,
        density_se: number,
        vehicles_mean: number,
        by_class: Some([f32::MAX; VehicleClass::COUNT]),
        space_occupancy: number,
        length_m: f32::MAX,
        frames_used: u32::MAX,
        frames_expected: u32::MAX,
        status: SampleZoneStatus::DetectionAutoSuspended,
        cells: Some(Cells {
            length_m: f32::MAX,
            density_veh_km: Some(std::iter::repeat_n(1.234_567_8e38, MAX_LANE_CELLS).collect()),
        }),
        error: Some(DensityError {
            calibration: 1.234_567_8e38,
            counting: 1.234_567_8e38,
            ci90: [1.234_567_8e38; 2],
        }),
        traffic: None,
    });
    let message = DensityMessage {
        site: name.clone(),
        seq: u64::MAX,
        clock_synced: false,
        report: WindowReport { from: UtcMs(0), to: UtcMs(900_000), lanes: lanes.collect() },
        calibration: CalibrationRef { id: name.clone(), sha256: [7; 32], rel_err: number },
        model: ModelRef { name, sha256: [7; 32] },
    };
    payload::density(&message, Some(false)).len()
}

/// The inodes of a process's sockets.
fn sockets(process: u32) -> BTreeSet<String> {
    let Ok(files) = fs::read_dir(format!("/proc/{process}/fd")) else { return BTreeSet::new() };
    let links = files.filter_map(|file| fs::read_link(file.ok()?.path()).ok());
    links
        .filter_map(|link| {
            Some(link.to_str()?.strip_prefix("socket:[")?.strip_suffix(']')?.to_owned())
        })
        .collect()
}

/// Holds every socket of the process against what it may have: one TCP connection to
/// `port` on this machine. Returns how many of those there are.
fn watch(process: u32, port: u16) -> usize {
    let mut unknown = sockets(process);
    let broker = format!("0100007F:{port:04X}");
    let mut connections = 0;
    for kind in ["tcp", "tcp6", "udp", "udp6", "raw", "raw6", "icmp"] {
        let table = fs::read_to_string(format!("/proc/{process}/net/{kind}")).unwrap_or_default();
        for line in table.lines().skip(1) {
            let fields: Vec<_> = line.split_whitespace().collect();
            let (remote, state, inode) = (fields[2], fields[3], fields[9]);
            if unknown.remove(inode) {
                assert_ne!(state, "0A", "a listening socket: {line}");
                assert_eq!((kind, remote), ("tcp", broker.as_str()), "not the broker: {line}");
                connections += 1;
            }
        }
    }
    // One that stands in no table of the internet is not connected yet, and will be seen
    // there at a later look; one that stands elsewhere is of a kind that is not needed.
    let left: Vec<_> = unknown.iter().filter(|inode| is_other(process, inode)).collect();
    assert!(left.is_empty(), "sockets of other kinds: {left:?}");
    connections
}

/// Whether the inode is that of a Unix or packet socket.
fn is_other(process: u32, inode: &str) -> bool {
    ["unix", "packet", "netlink"].iter().any(|kind| {
        let table = fs::read_to_string(format!("/proc/{process}/net/{kind}")).unwrap_or_default();
        table.lines().any(|line| line.split_whitespace().any(|field| field == inode))
    })
}

struct Daemon(Child);

impl Drop for Daemon {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

#[test]
fn only_numbers_leave_the_box_and_nothing_listens() {
    let broker = loopback::start_broker().expect("a broker");
    let sent = Arc::new(Mutex::new(Vec::new()));
    let port = proxy(broker, Arc::clone(&sent));
    let mut subscriber = Subscriber::connect(broker, "#").expect("a subscription");
    let folder = common::folder();
    let metrics = folder.path().join("verge.prom");
    let config = folder.path().join("verge.toml");
    let here = std::env::current_dir().expect("a working directory");
    let here = here.display();
    let text = format!(
        "site = \"k109f\"\n[camera]\nid = \"curve\"\ninterval_s = 1\n\
         source = \"{here}/{}\"\n\
         [model]\nfile = \"{here}/{}\"\n[lane_table]\nfile = \"{here}/{}\"\n\
         [windows]\nlengths_s = [10]\nmin_completeness = 0.0\n[mqtt]\nport = {port}\n\
         [home_assistant]\ndiscovery = true\n[metrics]\nfile = \"verge.prom\"\n",
        common::STREET_FRAMES,
        common::MODEL,
        common::STREET_TABLE
    );
    fs::write(&config, text).expect("writing the configuration");
    let mut daemon = Command::new(env!("CARGO_BIN_EXE_verge"))
        .args(["run", "--config", config.to_str().expect("UTF-8")])
        .stderr(Stdio::null())
        .spawn()
        .map(Daemon)
        .expect("the daemon starts");
    let process = daemon.0.id();
    let begun = Instant::now();
    let (mut topics, mut most, mut stopping) = (BTreeSet::new(), 0, false);
    loop {
        assert!(begun.elapsed() < PATIENCE, "only {topics:?}");
        most = most.max(watch(process, port));
        let Some((topic, payload)) = subscriber.next(Duration::from_millis(50)) else { continue };
        let is_density = topic == "verge/k109f/density/10s";
        topics.insert(topic);
        if is_density && !stopping {
            stopping = true;
            Command::new("kill").args(["-TERM", &process.to_string()]).status().expect("kill runs");
        }
        if payload == b"shutdown" {
            break;
        }
    }
    assert!(daemon.0.wait().expect("it ends").success());
    assert_eq!(most, 1, "the connection to the broker was seen, and never a second");

    let sent = sent.lock().expect("nobody panics with it");
    let messages = published(&sent);
    let largest = largest_message();
    assert!(messages.len() >= 5, "{} messages", messages.len());
    for (topic, payload) in &messages {
        let text = std::str::from_utf8(payload).expect("text and no picture");
        assert!(payload.len() <= largest, "{topic}: {} bytes", payload.len());
        // JPEG and PNG in base64; as they are, they are no UTF-8.
        assert!(!text.contains("/9j/") && !text.contains("iVBORw0KGgo"), "{topic}: {text}");
    }
    let pictures = [&b"\xff\xd8\xff"[..], b"\x89PNG"];
    for mark in pictures {
        assert!(!sent.windows(mark.len()).any(|bytes| bytes == mark), "{mark:02x?} left the box");
    }
    let published: BTreeSet<_> = messages.into_iter().map(|(topic, _)| topic).collect();
    assert_eq!(published, topics, "what the daemon sent is what arrived");
    let announced = topics.iter().filter(|topic| topic.starts_with("homeassistant/")).count();
    assert!(announced >= 2, "Home Assistant hears of the connection and of lanes: {topics:?}");
    let metrics = fs::read_to_string(metrics).expect("the metrics file");
    assert!(
        metrics.contains("\nverge_frames_total{site=\"")
            && metrics.contains(",outcome=\"measured\"} "),
        "{metrics}"
    );
}
