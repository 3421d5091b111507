//! The archive's door: which messages come in, and what one site may take of it.
//!
//! Owns the rules: a site's name is that of its topic, a message is one that the check of
//! `verge_messages` lets through, its times lie near now, and no site takes so much that others
//! wait for it. Reads no clock. What is refused goes to [`Aside`], with its reason.
//!
//! A site that sends more than [`ROWS_PER_S`] beyond its [`BURST_ROWS`], or windows that are
//! long past, is not refused: its messages go to a journal of their own, which is archived
//! after the others', a part at a time. Nothing of an honest box is lost that way, whose
//! archiver was away for days. Only what comes on top of [`LATER_BYTES`] is refused.

use super::aside::Aside;
use crate::broker::LARGEST;
use crate::message::{self, Message};
use std::collections::BTreeMap;
use std::time::{Duration, Instant};
use verge_messages::{Kind, Topic, Utc};

/// A window ends at most so long after now: clocks of boxes are not all set.
const AHEAD: Duration = Duration::from_secs(600);
/// A window that ended longer ago is not urgent.
const URGENT: Duration = Duration::from_secs(2 * 86_400);
/// Rows that a site may send at a steady rate: eight lanes of 32 cells each 10 s are 26 a second.
const ROWS_PER_S: f64 = 200.0;
/// Rows on top of that: what a box with four lanes of 12 cells and minutes has in two days.
const BURST_ROWS: f64 = 150_000.0;
/// Bytes that count as a row where a message has few rows for its size; a lane of 12 cells has 27
/// a row, one without cells some 200.
const BYTES_PER_ROW: usize = 128;
/// Bytes that wait for a site in the later journal.
const LATER_BYTES: u64 = 128 << 20;
/// Most sites that are kept apart; with more of them those that sent least lately are forgotten.
const MOST_SITES: usize = 50_000;

/// Verdict on a message.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Verdict {
    /// It is archived with the next compaction.
    Soon,
    /// It is archived when the others are.
    Later,
    /// It was refused.
    Refused,
    /// It says that a replay has ended, and nothing else.
    Empty,
}

/// Allowance of a site, and its use.
#[derive(Clone, Copy, Debug)]
struct Account {
    /// Rows that it may still send at once.
    rows: f64,
    since: Instant,
    later_bytes: u64,
}

/// Admission of messages, by site.
#[derive(Debug)]
pub(super) struct Door {
    root: String,
    /// How old a window may be.
    oldest: Duration,
    accounts: BTreeMap<String, Account>,
}

impl Door {
    /// A door to sites whose topics stand under `root`, for windows up to that old.
    pub(super) fn new(root: &str, oldest: Duration) -> Self {
        Self { root: root.to_owned(), oldest, accounts: BTreeMap::new() }
    }

    /// Judges a message that arrived `now`.
    pub(super) fn judge(
        &mut self,
        (topic, payload): (&str, &[u8]),
        (now, instant): (Utc, Instant),
        aside: &mut Aside,
    ) -> Verdict {
        if payload.is_empty() {
            return Verdict::Empty;
        }
        let Some((site, kind)) = Topic::kind_of(&self.root, topic) else {
            aside.refuse("?", "a topic that is not a site's", payload);
            return Verdict::Refused;
        };
        let verdict = self.judge_site((site, kind), payload, (now, instant));
        verdict.unwrap_or_else(|reason| {
            aside.refuse(site, &reason, payload);
            Verdict::Refused
        })
    }

    fn judge_site(
        &mut self,
        (site, kind): (&str, Kind),
        payload: &[u8],
        (now, instant): (Utc, Instant),
    ) -> Result<Verdict, String> {
        if !message::is_site(site) {
            return Err("letters, digits, '-', '_' and '.' make a site's name".into());
        }
        let reading = (payload.len() / BYTES_PER_ROW).max(1) as f64;
        let bytes = payload.len() as u64;
        let account = self.account(site, instant);
        let is_full = account.later_bytes + bytes > LATER_BYTES;
        let full = || format!("the site has {} MB waiting already", LATER_BYTES >> 20);
        if is_full && account.rows < reading {
            // Not even read: a box may send more than can be.
            return Err(full());
        }
        let message = self.examine((site, kind), payload, now)?;
        if kind != Kind::Density && message.span().0.0 < now.0.saturating_sub(ms(self.oldest)) {
            // The broker resends a site's retained messages at each connection, however old.
            return Ok(Verdict::Empty);
        }
        let rows = (message.rows() as f64).max(reading);
        let is_urgent = message.span().1.0 > now.0 - URGENT.as_millis() as i64;
        let account = self.account(site, instant);
        if is_urgent && account.rows >= rows {
            account.rows -= rows;
            Ok(Verdict::Soon)
        } else if is_full {
            account.rows -= reading;
            Err(full())
        } else {
            account.later_bytes += bytes;
            Ok(Verdict::Later)
        }
    }

    fn examine(
        &self,
        (site, kind): (&str, Kind),
        payload: &[u8],
        now: Utc,
    ) -> Result<Message, String> {
        if payload.len() > LARGEST {
            return Err(format!("it has more than {LARGEST} bytes"));
        }
        let message = message::read_kind(kind, payload)?;
        if message.site() != site {
            return Err(format!("its topic is of site {site}, it names {:?}", message.site()));
        }
        let (from, to) = message.span();
        let ends = if kind == Kind::Density { "its window ends at" } else { "it is of" };
        if to.0 > now.0.saturating_add(ms(AHEAD)) {
            return Err(format!("{ends} {to}, it is {now}"));
        }
        if kind == Kind::Density && from.0 < now.0.saturating_sub(ms(self.oldest)) {
            let days = self.oldest.as_secs() / 86_400;
            return Err(format!("its window began at {from}, over {days} days ago (--oldest)"));
        }
        Ok(message)
    }

    /// The account of a site, with its allowance since the last time.
    fn account(&mut self, site: &str, instant: Instant) -> &mut Account {
        if self.accounts.len() >= MOST_SITES && !self.accounts.contains_key(site) {
            // A site that has its burst back and nothing waiting is as good as a new one.
            let full = BURST_ROWS / ROWS_PER_S;
            self.accounts.retain(|_, account| {
                let idle = instant.duration_since(account.since).as_secs_f64();
                account.later_bytes > 0 || idle < full
            });
            if self.accounts.len() >= MOST_SITES {
                // A tenth at once, so that this is not done for each message.
                let mut since: Vec<_> = self.accounts.values().map(|it| it.since).collect();
                let (_, cut, _) = since.select_nth_unstable(MOST_SITES / 10);
                let (cut, mut left) = (*cut, MOST_SITES / 10);
                self.accounts.retain(|_, account| {
                    let goes = account.since <= cut && left > 0;
                    left -= usize::from(goes);
                    !goes
                });
            }
        }
        let new = Account { rows: BURST_ROWS, since: instant, later_bytes: 0 };
        let account = self.accounts.entry(site.to_owned()).or_insert(new);
        let earned = instant.duration_since(account.since).as_secs_f64() * ROWS_PER_S;
        account.rows = (account.rows + earned).min(BURST_ROWS);
        account.since = instant;
        account
    }

    /// The later journal has been archived as far as it went.
    pub(super) fn later_is_done(&mut self) {
        self.accounts.values_mut().for_each(|account| account.later_bytes = 0);
    }
}

/// A time in ms.
fn ms(time: Duration) -> i64 {
    i64::try_from(time.as_millis()).unwrap_or(i64::MAX)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::message::tests::message;

    const NOW: Utc = Utc(1_767_600_120_000);
    const DAYS: Duration = Duration::from_secs(92 * 86_400);

    struct Scene {
        door: Door,
        aside: Aside,
        begun: Instant,
        _folder: tempfile::TempDir,
    }

    fn scene() -> Scene {
        let folder = tempfile::tempdir().unwrap();
        let aside = Aside::open(folder.path(), "a").unwrap();
        let door = Door::new("verge", DAYS);
        Scene { door, aside, begun: Instant::now(), _folder: folder }
    }

    impl Scene {
        fn judge(&mut self, site: &str, payload: &str, after: Duration) -> Verdict {
            let topic = format!("verge/{site}/density/60s");
            let now = (NOW, self.begun + after);
            self.door.judge((&topic, payload.as_bytes()), now, &mut self.aside)
        }

        fn reason(&mut self) -> String {
            self.aside.told().join("; ")
        }
    }

    #[test]
    fn a_site_speaks_for_itself_alone_and_near_now() {
        let right = message("honest", 1, "2026-01-05T08:00:00.000Z");
        let mut scene = scene();
        let judge =
            |scene: &mut Scene, site: &str, text: &str| scene.judge(site, text, Duration::ZERO);
        assert_eq!(judge(&mut scene, "honest", &right), Verdict::Soon);
        assert_eq!(judge(&mut scene, "honest", ""), Verdict::Empty);
        let too_large = format!("{}{right}", " ".repeat(LARGEST));
        let ahead = message("honest", 1, "2026-01-05T08:12:00.000Z");
        let aeon = message("honest", 1, "2024-01-05T08:12:00.000Z");
        for (site, payload, said) in [
            ("evil", right.as_str(), "its topic is of site evil, it names \"honest\""),
            ("honest", &too_large, "it has more than 65536 bytes"),
            ("honest", &ahead, "its window ends at 2026-01-05T08:13:00.000Z, it is 2026-01-05T08"),
            ("honest", &aeon, "over 92 days ago (--oldest)"),
            ("honest", "{", "not a density message"),
        ] {
            assert_eq!(judge(&mut scene, site, payload), Verdict::Refused, "{said}");
            let reason = scene.reason();
            assert!(reason.contains(said), "{reason}");
        }
        let before = message("honest", 1, "2026-01-01T08:00:00.000Z");
        assert_eq!(judge(&mut scene, "honest", &before), Verdict::Later, "that is not urgent");
    }

    #[test]
    fn health_and_alarms_come_in_by_the_same_rules() {
        use crate::message::tests::{alarm, health};
        let mut scene = scene();
        let now = "2026-01-05T08:00:00.000Z";
        let judge = |scene: &mut Scene, topic: &str, payload: &str| {
            let times = (NOW, scene.begun);
            scene.door.judge((topic, payload.as_bytes()), times, &mut scene.aside)
        };
        let moved = alarm("a", "camera_moved", true, now);
        assert_eq!(judge(&mut scene, "verge/a/alarm/camera_moved", &moved), Verdict::Soon);
        let fine = health("a", now, true);
        assert_eq!(judge(&mut scene, "verge/a/health", &fine), Verdict::Soon);
        for (topic, payload, said) in [
            ("verge/b/health", &fine, "its topic is of site b, it names \"a\""),
            ("verge/a/health", &moved, "not a message of health: "),
            ("verge/a/alarm/camera_moved", &fine, "not a message of alarm"),
            ("verge/a/alarm/x/y", &moved, "a topic that is not a site's"),
            (
                "verge/a/health",
                &health("a", "2026-01-05T09:00:00.000Z", true),
                "it is of 2026-01-05T09",
            ),
        ] {
            assert_eq!(judge(&mut scene, topic, payload), Verdict::Refused, "{said}");
            let reason = scene.reason();
            assert!(reason.contains(said), "{reason}");
        }
    }

    #[test]
    fn a_site_that_sends_too_much_waits_and_others_do_not() {
        let mut scene = scene();
        let evil = message("evil", 1, "2026-01-05T08:00:00.000Z");
        let rows = message::rows(&message::read(evil.as_bytes()).unwrap());
        assert_eq!(rows, 8);
        let padded = evil.clone() + &" ".repeat(8 * BYTES_PER_ROW);
        let soon = (BURST_ROWS as usize) / rows;
        for _ in 0..soon - 2 {
            assert_eq!(scene.judge("evil", &evil, Duration::ZERO), Verdict::Soon);
        }
        // A large message with few rows counts by its size.
        assert_eq!(scene.judge("evil", &padded, Duration::ZERO), Verdict::Soon);
        assert_eq!(scene.judge("evil", &evil, Duration::ZERO), Verdict::Later);
        let honest = message("honest", 1, "2026-01-05T08:00:00.000Z");
        assert_eq!(scene.judge("honest", &honest, Duration::ZERO), Verdict::Soon);
        // A second earns 200 rows.
        let second = Duration::from_secs(1);
        for _ in 0..200 / rows {
            assert_eq!(scene.judge("evil", &evil, second), Verdict::Soon);
        }
        assert_eq!(scene.judge("evil", &evil, second), Verdict::Later);
        let account = scene.door.accounts.get_mut("evil").unwrap();
        account.later_bytes = LATER_BYTES;
        assert_eq!(scene.judge("evil", &evil, second), Verdict::Refused);
        assert_eq!(scene.judge("evil", "unread", second), Verdict::Refused);
        let reason = scene.reason();
        assert!(reason.contains("2 messages refused, the first: the site has 128 MB"), "{reason}");
        scene.door.later_is_done();
        assert_eq!(scene.judge("evil", &evil, second), Verdict::Later);
    }

    #[test]
    fn sites_without_number_take_no_memory_without_bound() {
        let mut scene = scene();
        for site in 0..MOST_SITES + 100 {
            let _ = scene.door.account(&site.to_string(), scene.begun);
        }
        let count = scene.door.accounts.len();
        assert!((MOST_SITES / 2..=MOST_SITES).contains(&count), "{count}");
    }
}
