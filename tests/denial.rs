//! Brokers that deny, misbehave or are set up in another way than the box expects: no window is
//! lost without a word, none waits behind something else, and nobody is flooded with connections.
//! Their wording is tested in `tests/broker_words.rs`.

mod common;
#[path = "common/fake_broker.rs"]
mod fake_broker;

use common::mosquitto::Running;
use fake_broker::{FakeBroker, Manners};
use std::os::unix::net::UnixDatagram;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};
use verge::daemon::outlet::Outlet;
use verge::daemon::publish::home_assistant::Announcement;
use verge::daemon::publish::{Format, Identity, MqttSettings, MqttVersion};
use verge::density::WindowReport;
use verge::lane::Name;
use verge::sensor::ClosedWindow;
use verge::units::UtcMs;
use verge::wire::{CalibrationRef, ModelRef};

const PATIENCE: Duration = Duration::from_secs(40);
/// The longest wait before a fourth connection, and a little more.
const LAST_WAIT: Duration = Duration::from_secs(5);

fn outlet(broker: &FakeBroker) -> Outlet {
    outlet_with(MqttSettings {
        version: MqttVersion::Auto,
        ..MqttSettings::local(broker.port, "verge/deny")
    })
}

fn outlet_with(settings: MqttSettings) -> Outlet {
    let name = |text| Name::try_from(text).expect("short");
    let identity = Identity::new("deny", &ModelRef { name: name("m"), sha256: [7; 32] });
    Outlet::in_memory(settings, Format::Json, identity)
}

fn accept(outlet: &mut Outlet, minute: i64) {
    let (from, to) = (UtcMs((minute - 1) * 60_000), UtcMs(minute * 60_000));
    let report = WindowReport { from, to, lanes: Default::default() };
    let id = Name::try_from("c").expect("short");
    let calibration = &CalibrationRef { id, sha256: [8; 32], rel_err: None };
    outlet.density(ClosedWindow { report: &report, calibration }, true);
}

/// A message that is kept until a broker has it, as those for Home Assistant are.
fn state(outlet: &Outlet, topic: &str) {
    let payload = b"{}".to_vec();
    outlet.publisher().announce(Announcement { topic: topic.to_owned(), payload });
}

fn tend(outlet: &mut Outlet, what: &str, done: impl Fn(&Outlet) -> bool) {
    let until = Instant::now() + PATIENCE;
    while !done(outlet) {
        assert!(Instant::now() < until, "{what}: {:?}", outlet.counts());
        outlet.tend();
        std::thread::sleep(Duration::from_millis(10));
    }
}

fn tend_for(outlet: &mut Outlet, time: Duration) {
    let until = Instant::now() + time;
    tend(outlet, "", |_| Instant::now() >= until);
}

/// A window, given before the session and after it, arrives.
fn delivers(broker: &FakeBroker) -> Outlet {
    let mut outlet = outlet(broker);
    accept(&mut outlet, 1);
    tend(&mut outlet, "an arrear", |outlet| outlet.counts().waiting == 0);
    accept(&mut outlet, 2);
    tend(&mut outlet, "a live window", |outlet| outlet.counts().waiting == 0);
    assert_eq!(broker.windows(), 2);
    outlet
}

fn versions(broker: &FakeBroker) -> Vec<u8> {
    broker.seen(|seen| seen.connects.iter().map(|&(_, version)| version).collect())
}

#[test]
fn version_5_is_spoken_first_and_3_where_it_must() {
    let broker = FakeBroker::start(Manners::default());
    let _outlet = delivers(&broker);
    assert_eq!(versions(&broker), [5]);
    let broker = FakeBroker::start(Manners { versions: vec![4], ..Manners::default() });
    let _outlet = delivers(&broker);
    assert_eq!(versions(&broker), [5, 4]);
    let mute = Manners { versions: vec![4], mute: true, ..Manners::default() };
    let broker = FakeBroker::start(mute);
    let _outlet = delivers(&broker);
    assert_eq!(versions(&broker), [5, 4]);
}

#[test]
fn a_broker_that_retains_nothing_gets_windows_all_the_same() {
    for versions in [vec![5], vec![4]] {
        let manners = Manners { versions, keeps_nothing: true, ..Manners::default() };
        let broker = FakeBroker::start(manners);
        let _outlet = delivers(&broker);
        assert!(broker.connections() <= 4);
    }
}

#[test]
fn a_window_that_nobody_subscribes_to_stays() {
    // MQTT 5, 3.4.2.1: no matching subscribers.
    let unheard = Manners { reason: Some(("density/", 0x10)), ..Manners::default() };
    let broker = FakeBroker::start(unheard);
    let mut outlet = outlet(&broker);
    tend(&mut outlet, "a session", Outlet::is_open);
    (1..=3).for_each(|n| accept(&mut outlet, n));
    tend_for(&mut outlet, Duration::from_secs(2));
    assert_eq!((outlet.counts().waiting, broker.windows()), (3, 0));
    assert!(outlet.is_open(), "the session goes on");
    let tried = |seen: &fake_broker::Seen| seen.came.iter().filter(|t| t.contains("dens")).count();
    assert!(broker.seen(tried) <= 3, "it is not tried over and over");
    // Somebody subscribes: they come without a new session.
    broker.change(Manners::default());
    tend(&mut outlet, "delivery", |outlet| outlet.counts().waiting == 0);
    assert_eq!((broker.windows(), broker.connections()), (3, 1));
}

#[test]
fn a_window_that_is_acknowledged_and_thrown_away_stays() {
    let drops = Manners { versions: vec![4], drops: Some("density/"), ..Manners::default() };
    let broker = FakeBroker::start(drops);
    let mut outlet = outlet(&broker);
    tend(&mut outlet, "a session", Outlet::is_open);
    accept(&mut outlet, 1);
    tend(&mut outlet, "the verdict", |outlet| outlet.publisher().counts().1 > 0);
    assert_eq!(outlet.counts().waiting, 1);
    // The list is corrected, and a new session tries again.
    broker.change(Manners { versions: vec![4], ..Manners::default() });
    broker.hang_up();
    tend(&mut outlet, "delivery", |outlet| outlet.counts().waiting == 0);
    assert_eq!(broker.windows(), 1);
}

#[test]
fn who_may_not_read_is_believed_with_3_1_1() {
    let deaf = Manners { versions: vec![4], deaf: true, ..Manners::default() };
    let broker = FakeBroker::start(deaf);
    let _outlet = delivers(&broker);
}

#[test]
fn a_topic_on_which_the_broker_closes_is_set_aside_and_the_others_pass() {
    std::thread::scope(|scope| {
        for part in ["density/", "homeassistant", "alarm"] {
            scope.spawn(move || closes_on(part));
        }
    });
}

fn closes_on(part: &'static str) {
    let broker = FakeBroker::start(Manners { closes_on: Some(part), ..Manners::default() });
    let mut outlet = outlet(&broker);
    // A dozen lanes' worth of discovery: one of them stands for all.
    (0..12).for_each(|n| state(&outlet, &format!("homeassistant/x{n}/config")));
    state(&outlet, "verge/deny/alarm/a");
    state(&outlet, "verge/deny/health");
    accept(&mut outlet, 1);
    let others = |outlet: &Outlet| {
        outlet.is_open()
            && broker.seen(|seen| {
                let took = |topic| seen.taken.iter().any(|(t, _)| t.contains(topic));
                ["density/", "homeassistant", "alarm", "health"]
                    .iter()
                    .all(|&topic| topic == part || took(topic))
            })
    };
    tend(&mut outlet, part, others);
    let settled = |outlet: &Outlet| outlet.is_open() && broker.quiet_for() > LAST_WAIT;
    tend(&mut outlet, part, settled);
    assert!(broker.connections() <= 5, "{part}: {}", broker.connections());
    assert_eq!(outlet.counts().waiting, u64::from(part == "density/"));
    // And there it stays; a live window has a topic of its own, which costs its own.
    let most = broker.connections() + usize::from(part == "density/");
    accept(&mut outlet, 2);
    tend_for(&mut outlet, Duration::from_secs(2));
    assert!(broker.connections() <= most, "{part}: {}", broker.connections());
}

#[test]
fn what_is_too_large_is_set_aside_and_the_rest_passes() {
    // A maximum packet size of 200 bytes, said and not said.
    let said = Manners { properties: vec![0x27, 0, 0, 0, 200], ..Manners::default() };
    let mute = Manners { versions: vec![4], closes_from: Some(200), ..Manners::default() };
    std::thread::scope(|scope| {
        scope.spawn(|| sets_aside_by_size(said, 1));
        scope.spawn(|| sets_aside_by_size(mute, 5));
    });
}

fn sets_aside_by_size(manners: Manners, most: usize) {
    let broker = FakeBroker::start(manners);
    let mut outlet = outlet(&broker);
    accept(&mut outlet, 1);
    state(&outlet, "verge/deny/health");
    let passed = |outlet: &Outlet| {
        outlet.is_open() && broker.seen(|seen| seen.taken.iter().any(|t| t.0.contains("health")))
    };
    tend(&mut outlet, "health", passed);
    let settled = |outlet: &Outlet| outlet.is_open() && broker.quiet_for() > LAST_WAIT;
    tend(&mut outlet, "a session that stays", settled);
    assert!(outlet.is_open() && broker.connections() <= most, "{}", broker.connections());
    assert_eq!(outlet.counts().waiting, 1, "it waits for a larger limit");
}

#[test]
fn a_broker_that_acknowledges_nothing_is_left() {
    let broker = FakeBroker::start(Manners { ignores: Some("density/"), ..Manners::default() });
    let keep_alive = Duration::from_secs(1);
    let settings = MqttSettings { keep_alive, ..MqttSettings::local(broker.port, "verge/deny") };
    let mut outlet = outlet_with(settings);
    accept(&mut outlet, 1);
    tend(&mut outlet, "another connection", |_| broker.connections() > 1);
    assert_eq!(outlet.counts().waiting, 1);
    // It comes to itself.
    broker.change(Manners::default());
    tend(&mut outlet, "delivery", |outlet| outlet.counts().waiting == 0);
}

/// Resident memory of this program, MB.
fn resident_mb() -> usize {
    let status = std::fs::read_to_string("/proc/self/status").expect("Linux");
    let line = status.lines().find(|line| line.starts_with("VmRSS:")).expect("a line");
    line.split_whitespace().nth(1).and_then(|kb| kb.parse::<usize>().ok()).expect("a number") / 1024
}

#[test]
fn floods_of_version_5_take_no_memory() {
    let alias = |n: u8| [&b"\x30\x20\x00\x01t\x03\x23\x00"[..], &[n], &[b'x'; 23]].concat();
    let floods = [
        b"\x20\x03\x00\x00\x00".to_vec(),
        (1..=200).flat_map(alias).collect(),
        [&b"\x30\x80\x08\x00\x01t\x00"[..], &[b'x'; 1020]].concat(),
        b"\xd0\x00".to_vec(),
        b"\x40\x02\x00\x63".to_vec(),
    ];
    for (index, flood) in floods.into_iter().enumerate() {
        let broker = FakeBroker::start(Manners { flood: Some(flood), ..Manners::default() });
        let mut outlet = outlet(&broker);
        tend(&mut outlet, "a connection", |_| broker.connections() > 0);
        let before = resident_mb();
        tend_for(&mut outlet, Duration::from_millis(1500));
        let after = resident_mb();
        assert!(after < before + 16, "flood {index}: {before} MB, then {after} MB");
        // Whoever floods and still takes windows gets them; who breaks the protocol is left.
        assert!(broker.connections() <= 5, "flood {index}: {}", broker.connections());
    }
}

#[test]
fn a_second_client_of_the_same_id_is_given_way() {
    // MQTT 5, 3.14.2.1: session taken over.
    let flood = Some(b"\xe0\x02\x8e\x00".to_vec());
    let broker = FakeBroker::start(Manners { flood, ..Manners::default() });
    let mut outlet = outlet(&broker);
    tend(&mut outlet, "a connection", |_| broker.connections() > 0);
    tend_for(&mut outlet, Duration::from_secs(4));
    assert_eq!(broker.connections(), 1);
    // 3.1.1 has no words for it: sessions that end early again and again.
    let ends = Manners { versions: vec![4], ends_after: Some(1), ..Manners::default() };
    let broker = FakeBroker::start(ends);
    let mut outlet = self::outlet(&broker);
    let begun = Instant::now();
    let mut minute = 0;
    while begun.elapsed() < Duration::from_secs(6) {
        minute += 1;
        accept(&mut outlet, minute);
        tend_for(&mut outlet, Duration::from_millis(300));
    }
    assert!(broker.connections() <= 10, "{}", broker.connections());
    assert!(broker.windows() > 0, "windows pass meanwhile");
}

/// Presence messages that a broker has taken.
fn greetings(broker: &FakeBroker) -> usize {
    broker.seen(|seen| seen.taken.iter().filter(|(topic, _)| topic.ends_with("presence")).count())
}

/// `verge run` on recorded frames, with its spool in `folder`.
fn daemon(broker: &FakeBroker, folder: &Path, prepare: impl FnOnce(&mut Command)) -> Running {
    let here = std::env::current_dir().expect("a working directory");
    let here = here.display();
    let text = format!(
        "site = \"deny\"\n[camera]\nid = \"curve\"\ninterval_s = 5\nwatch = false\n\
         source = \"{here}/{}\"\n[model]\nfile = \"{here}/{}\"\n[lane_table]\nfile = \"{here}/{}\"\n\
         [windows]\nlengths_s = [10]\n[mqtt]\nport = {}\n",
        common::STREET_FRAMES,
        common::MODEL,
        common::STREET_TABLE,
        broker.port
    );
    let path = folder.join("verge.toml");
    std::fs::write(&path, text).expect("written");
    let mut command = Command::new(env!("CARGO_BIN_EXE_verge"));
    command.args(["run", "--config", path.to_str().expect("UTF-8")]).stderr(Stdio::null());
    prepare(&mut command);
    command.spawn().map(Running).expect("it starts")
}

fn wait(what: &str, done: impl Fn() -> bool) {
    let until = Instant::now() + PATIENCE;
    while !done() {
        assert!(Instant::now() < until, "{what}");
        std::thread::sleep(Duration::from_millis(20));
    }
}

#[test]
fn descriptors_that_run_out_do_not_end_publishing() {
    let (broker, folder) = (FakeBroker::start(Manners::default()), common::folder());
    let mut daemon = daemon(&broker, folder.path(), |_| ());
    wait("a session", || greetings(&broker) > 0);
    let limit = |soft: &str| {
        let id = daemon.0.id().to_string();
        Command::new("prlimit").args(["--pid", &id, &format!("--nofile={soft}:")]).status()
    };
    if !limit("4").is_ok_and(|status| status.success()) {
        return common::skip("there is no prlimit");
    }
    broker.hang_up();
    std::thread::sleep(Duration::from_secs(3));
    let before = greetings(&broker);
    assert!(limit("1024").expect("it ran").success());
    wait("a new session", || greetings(&broker) > before);
    assert!(daemon.0.try_wait().expect("ours").is_none(), "the process goes on");
}

/// Stops one thread of another program for as long as this one lives.
fn freeze(thread: i32) {
    for request in [libc::PTRACE_SEIZE, libc::PTRACE_INTERRUPT] {
        // SAFETY: neither request reads or writes memory of ours.
        let outcome = unsafe { libc::ptrace(request, thread, 0, 0) };
        assert_eq!(outcome, 0, "{}", std::io::Error::last_os_error());
    }
}

/// The number of the daemon's publishing thread.
fn publishing_thread(daemon: &Running) -> i32 {
    let tasks = std::fs::read_dir(format!("/proc/{}/task", daemon.0.id())).expect("it lives");
    let paths = tasks.map(|task| task.expect("a thread").path());
    let is_it = |path: &PathBuf| {
        std::fs::read_to_string(path.join("comm")).is_ok_and(|name| name.trim() == "publish")
    };
    let path = paths.into_iter().find(is_it).expect("a thread of that name");
    path.file_name().and_then(|name| name.to_str()?.parse().ok()).expect("a number")
}

#[test]
fn a_publishing_thread_that_hangs_ends_the_process_and_the_next_delivers() {
    // Three minutes by the clock: a name, a connection and a write may each take their time.
    if std::env::var_os("VERGE_LONG").is_none() {
        return;
    }
    let (broker, folder) = (FakeBroker::start(Manners::default()), common::folder());
    let name = folder.path().join("notify");
    let manager = UnixDatagram::bind(&name).expect("a socket");
    manager.set_nonblocking(true).expect("it is set");
    let mut first = daemon(&broker, folder.path(), |command| {
        command.env("NOTIFY_SOCKET", &name);
    });
    wait("a window", || broker.windows() > 0);
    let thread = publishing_thread(&first);
    freeze(thread);
    let (frozen, mut fed) = (Instant::now(), Duration::ZERO);
    let ended = loop {
        let mut word = [0; 200];
        while let Ok(length) = manager.recv(&mut word) {
            if word[..length].starts_with(b"WATCHDOG=1") {
                fed = frozen.elapsed();
            }
        }
        // A traced thread's end is heard by its tracer before the process is gone.
        // SAFETY: no status is asked for.
        unsafe { libc::waitpid(thread, std::ptr::null_mut(), libc::WNOHANG | libc::__WALL) };
        if let Some(status) = first.0.try_wait().expect("ours") {
            break status;
        }
        assert!(frozen.elapsed() < Duration::from_secs(240), "the process goes on");
        std::thread::sleep(Duration::from_millis(100));
    };
    println!("last fed after {fed:?}, ended after {:?} with {ended}", frozen.elapsed());
    assert!(fed < Duration::from_secs(70), "the watchdog was fed after {fed:?}");
    // A status that the unit's Restart= takes for a failure.
    assert_eq!(ended.code(), Some(70));
    let before = broker.windows();
    let _second = daemon(&broker, folder.path(), |_| ());
    // A window each ten seconds was accepted meanwhile.
    wait("what waited", || broker.windows() >= before + 15);
}

#[test]
fn a_refusal_of_any_kind_sees_at_most_twelve_connections_in_two_minutes() {
    // Two minutes by the clock: what follows from them is `backoff`'s own test.
    if std::env::var_os("VERGE_LONG").is_none() {
        return;
    }
    let kinds = [
        Manners { refuses: Some(5), ..Manners::default() },
        Manners { refuses: Some(0x87), versions: vec![5], ..Manners::default() },
        Manners { versions: vec![9], ..Manners::default() },
        Manners { versions: vec![9], mute: true, ..Manners::default() },
        Manners { closes_on: Some("presence"), ..Manners::default() },
        Manners { closes_on: Some("density/"), ..Manners::default() },
        Manners { closes_on: Some("homeassistant"), ..Manners::default() },
        Manners { ends_after: Some(1), ..Manners::default() },
        Manners { flood: Some(b"\xe0\x02\x8e\x00".to_vec()), ..Manners::default() },
        Manners { closes_from: Some(100), ..Manners::default() },
    ];
    let brokers: Vec<_> = kinds.into_iter().map(FakeBroker::start).collect();
    let mut outlets: Vec<_> = brokers.iter().map(outlet).collect();
    let begun = Instant::now();
    for second in 0..120 {
        for outlet in &mut outlets {
            accept(outlet, second);
            state(outlet, "homeassistant/x/config");
            while begun.elapsed() < Duration::from_secs(second.unsigned_abs()) {
                std::thread::sleep(Duration::from_millis(20));
            }
            outlet.tend();
        }
    }
    let counts: Vec<_> = brokers.iter().map(FakeBroker::connections).collect();
    println!("connections in two minutes: {counts:?}");
    assert!(counts.iter().all(|&count| count <= 12), "{counts:?}");
}
