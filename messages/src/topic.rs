//! The topics under a site's root.

use crate::Alarm;
use std::fmt;
use std::time::Duration;

/// A topic of a site, without its root (`verge/<site>` where nothing else is configured).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Topic {
    /// Whether the box is there; retained.
    Presence,
    /// One message a window of that length, as it closes.
    Density(Duration),
    /// The latest live window of that length; retained.
    Latest(Duration),
    /// Windows that were measured while the broker was away.
    Replay(Duration),
    /// The state of the sensor; retained.
    Health,
    /// An alarm, when it is raised and when it is over; retained.
    Alarm(Alarm),
}

impl Topic {
    /// The whole topic under a root.
    pub fn under(self, root: &str) -> String {
        format!("{root}/{self}")
    }

    /// Whether the broker keeps the latest message for those who come later.
    pub const fn is_retained(self) -> bool {
        match self {
            Self::Presence | Self::Health | Self::Alarm(_) | Self::Latest(_) => true,
            Self::Density(_) | Self::Replay(_) => false,
        }
    }

    /// Site and kind of a topic of a message, where sites stand under `root`:
    /// `verge/k109f/alarm/no_picture`. None where it is another topic.
    pub fn kind_of<'t>(root: &str, topic: &'t str) -> Option<(&'t str, Kind)> {
        if let Some((site, _)) = Self::density_of(root, topic) {
            return Some((site, Kind::Density));
        }
        let rest = topic.strip_prefix(root)?.strip_prefix('/')?;
        let (site, rest) = rest.split_once('/')?;
        let is_alarm = rest.strip_prefix("alarm/").is_some_and(|name| !name.contains('/'));
        match rest {
            "health" => Some((site, Kind::Health)),
            _ if is_alarm => Some((site, Kind::Alarm)),
            _ => None,
        }
    }

    /// Site and window name of a density topic, live or replayed, where sites stand under
    /// `root`: `verge/k109f/density/60s`. None where it is another topic.
    pub fn density_of<'t>(root: &str, topic: &'t str) -> Option<(&'t str, &'t str)> {
        let rest = topic.strip_prefix(root)?.strip_prefix('/')?;
        let (site, rest) = rest.split_once('/')?;
        let window = rest.strip_prefix("replay/").unwrap_or(rest).strip_prefix("density/")?;
        (!window.contains('/')).then_some((site, window))
    }
}

/// Kind of a message.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// A window, live or replayed.
    Density,
    /// The state of the sensor.
    Health,
    /// An alarm.
    Alarm,
}

impl fmt::Display for Topic {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Presence => f.write_str("presence"),
            Self::Density(window) => write!(f, "density/{}", window_name(*window)),
            Self::Latest(window) => write!(f, "latest/{}", window_name(*window)),
            Self::Replay(window) => write!(f, "replay/density/{}", window_name(*window)),
            Self::Health => f.write_str("health"),
            Self::Alarm(alarm) => write!(f, "alarm/{}", alarm.name()),
        }
    }
}

/// The window's name in topics: `60s`, `5min`.
pub fn window_name(length: Duration) -> String {
    match length.as_secs() {
        seconds if seconds >= 300 && seconds % 60 == 0 => format!("{}min", seconds / 60),
        seconds => format!("{seconds}s"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn windows_have_the_names_of_the_design() {
        for (seconds, name) in
            [(10, "10s"), (60, "60s"), (120, "120s"), (300, "5min"), (900, "15min")]
        {
            assert_eq!(window_name(Duration::from_secs(seconds)), name);
        }
    }

    #[test]
    fn the_site_is_read_from_a_topic() {
        let of = |topic| Topic::density_of("verge", topic);
        assert_eq!(of("verge/k109f/density/60s"), Some(("k109f", "60s")));
        assert_eq!(of("verge/k109f/replay/density/15min"), Some(("k109f", "15min")));
        for other in ["verge/k109f/health", "other/k109f/density/60s", "verge/density/60s", ""] {
            assert_eq!(of(other), None, "{other}");
        }
        let written = Topic::Replay(Duration::from_secs(60)).under("road/7");
        assert_eq!(Topic::density_of("road", &written), Some(("7", "60s")));
    }
}
