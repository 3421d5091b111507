//! Checks of a configuration's values.

use super::sections::MAX_TIMEOUT_S;
use super::{Config, Mqtt};
use crate::daemon::address::Address;
use crate::daemon::foreign::{is_plain, shown};
use crate::daemon::publish::Format;
use crate::daemon::trust::Trust;
use crate::density::check_lengths;
use crate::units::MAX_LANES;

impl Config {
    /// The first key with a wrong value, and what would be right.
    pub(super) fn check(&self) -> Result<(), (&'static str, String)> {
        let known = |ok: bool, key, reason: String| if ok { Ok(()) } else { Err((key, reason)) };
        self.check_names()?;
        let plain = |text: &str| !text.is_empty() && !text.contains(['+', '#', '\0']);
        self.site.check()?;
        known(
            self.mqtt.root.as_deref().is_none_or(plain),
            "mqtt.root",
            format!(
                "\"{}\": give a topic without + #",
                shown(self.mqtt.root.as_deref().unwrap_or_default())
            ),
        )?;
        if let Some(reason) = self.camera.impossible() {
            return Err(("camera.source", reason));
        }
        self.check_camera()?;
        for (key, seconds, most) in [
            ("camera.interval_s", self.camera.interval_s, 3600.0),
            ("camera.timeout_s", self.camera.timeout_s, MAX_TIMEOUT_S),
        ] {
            known(
                (0.01..=most).contains(&seconds),
                key,
                format!("{seconds} s: give 0.01 to {most}"),
            )?;
        }
        check_lengths(&self.window_lengths(), self.interval())
            .map_err(|reason| ("windows.lengths_s", reason.to_string()))?;
        known(
            (0.0..=1.0).contains(&self.windows.min_completeness),
            "windows.min_completeness",
            format!("{}: give 0 to 1", self.windows.min_completeness),
        )?;
        known(
            (10.0..=300.0).contains(&self.traffic.top_speed_kmh),
            "traffic.top_speed_kmh",
            format!("{} km/h: give 10 to 300", self.traffic.top_speed_kmh),
        )?;
        known(
            self.traffic.sections().count() == self.traffic.section_m.len(),
            "traffic.section_m",
            {
                let lanes: Vec<_> = self.traffic.section_m.keys().map(|lane| shown(lane)).collect();
                format!("lanes {}: give numbers from 1 to {MAX_LANES}", lanes.join(", "))
            },
        )?;
        let tables = &self.lane_table;
        let is_main = tables.presets.contains(&tables.file);
        known(!is_main, "lane_table.presets", {
            let file = shown(&tables.file.display().to_string());
            format!("{file} is already lane_table.file: name the tables of the other presets alone")
        })?;
        let twice = tables.presets.iter().enumerate();
        let mut twice = twice.filter(|(at, file)| tables.presets[..*at].contains(file));
        if let Some((_, file)) = twice.next() {
            let file = shown(&file.display().to_string());
            return Err(("lane_table.presets", format!("{file} twice: leave one out")));
        }
        known(
            self.lane_table.presets.is_empty() || self.camera.watch,
            "lane_table.presets",
            "presets are told apart by their scene: leave camera.watch = true".to_owned(),
        )?;
        known(
            self.model.score.is_none_or(|score| (0.0..=1.0).contains(&score)),
            "model.score",
            format!("{}: give 0 to 1", self.model.score.unwrap_or_default()),
        )?;
        let assistant = &self.home_assistant;
        known(
            plain(&assistant.prefix)
                && is_plain(&assistant.prefix)
                && !assistant.prefix.starts_with(['/', '$', ' '])
                && !assistant.prefix.ends_with(['/', ' ']),
            "home_assistant.prefix",
            format!(
                "\"{}\": give a topic without + #, blanks or / at its ends, and no $ in front",
                shown(&assistant.prefix)
            ),
        )?;
        known(
            !assistant.discovery || self.mqtt.format == Format::Json,
            "home_assistant.discovery",
            "Home Assistant reads json: take mqtt.format = \"json\" or turn it off".to_owned(),
        )?;
        known(
            self.mqtt.keep_alive_s >= 5,
            "mqtt.keep_alive_s",
            format!("{} s: give at least 5", self.mqtt.keep_alive_s),
        )?;
        let Mqtt { tls, ca_file, certificate_file, key_file, .. } = &self.mqtt;
        known(
            *tls || (ca_file.is_none() && certificate_file.is_none() && key_file.is_none()),
            "mqtt.tls",
            "certificates are named, but the connection is not secured: tls = true".into(),
        )?;
        known(
            certificate_file.is_some() == key_file.is_some(),
            "mqtt.certificate_file",
            "a certificate and its key (key_file) go together".into(),
        )?;
        known(
            self.serial.window_s.is_none_or(|length| self.windows.lengths_s.contains(&length)),
            "serial.window_s",
            {
                let lengths: Vec<_> = self.windows.lengths_s.iter().map(u64::to_string).collect();
                format!(
                    "{} s: give one of windows.lengths_s ({})",
                    self.serial.window_s.unwrap_or_default(),
                    lengths.join(", ")
                )
            },
        )?;
        known(
            (1200..=921_600).contains(&self.serial.baud),
            "serial.baud",
            format!("{}: give 1200 to 921600, as the node has it", self.serial.baud),
        )?;
        known(
            (0.1..=1000.0).contains(&self.mqtt.replay_per_s),
            "mqtt.replay_per_s",
            format!("{}: give 0.1 to 1000", self.mqtt.replay_per_s),
        )?;
        known(
            (0.01..=60.0).contains(&self.spool.days),
            "spool.days",
            format!("{}: give 0.01 to 60", self.spool.days),
        )
    }

    /// Names that a template, a script or an address has left odd.
    fn check_names(&self) -> Result<(), (&'static str, String)> {
        // With a zone or without.
        let is_ipv6 = |host: &str| {
            let address = host.split('%').next().unwrap_or_default();
            address.parse::<std::net::Ipv6Addr>().is_ok()
        };
        let odd_host = |host: &str| {
            if host.contains("://") {
                Some("a name or an address alone, and mqtt.tls = true for mqtts://")
            } else if host.trim() != host || host.contains(char::is_whitespace) {
                Some("it has a blank in it")
            } else if host.contains(['[', ']']) {
                Some("leave the brackets away")
            } else if host.contains(':') && !is_ipv6(host) {
                Some("give the port in mqtt.port")
            } else if host.is_empty() || host.contains(['/', '@']) {
                Some("give a name or an address")
            } else {
                None
            }
        };
        if self.mqtt.port == 0 {
            return Err((
                "mqtt.port",
                "0: give 1 to 65535; 1883 is usual, 8883 with TLS".to_owned(),
            ));
        }
        if let Some(what) = odd_host(&self.mqtt.host) {
            return Err(("mqtt.host", format!("\"{}\": {what}", shown(&self.mqtt.host))));
        }
        let root = self.mqtt.root.as_deref().unwrap_or_default();
        for (key, text) in [("site", self.site.id.as_str()), ("mqtt.root", root)] {
            let what = if text.contains("${") || text.contains("{{") {
                "a placeholder that nobody has filled in"
            } else if text.trim() != text || !is_plain(text) {
                "blanks at its ends, or characters that do not show"
            } else if matches!(text, "." | "..") {
                "it is no name: it stands for a folder"
            } else {
                continue;
            };
            return Err((key, format!("\"{}\": {what}", shown(text))));
        }
        if root.starts_with(['/', '$']) || root.ends_with('/') {
            return Err((
                "mqtt.root",
                format!(
                    "\"{}\": no / at its ends, and no $ in front, which is the broker's own",
                    shown(root)
                ),
            ));
        }
        if self.mqtt.password_file.is_some() && self.mqtt.user.is_none() {
            return Err(("mqtt.password_file", "whose is it? Set mqtt.user too".to_owned()));
        }
        Ok(())
    }

    /// Keys of the camera that do not go together.
    fn check_camera(&self) -> Result<(), (&'static str, String)> {
        let camera = &self.camera;
        let address = Address::parse(&camera.source).ok();
        let has_login = address.as_ref().is_some_and(|address| address.login.is_some());
        if has_login && camera.user.is_some() {
            return Err((
                "camera.user",
                "the address holds a login too: leave one of them away".to_owned(),
            ));
        }
        if camera.password_file.is_some() && camera.user.is_none() {
            return Err(("camera.password_file", "whose is it? Set camera.user too".to_owned()));
        }
        let secure = address.is_some_and(|address| address.secure);
        for (key, is_set) in [
            ("camera.ca_file", camera.ca_file.is_some()),
            ("camera.fingerprint", camera.fingerprint.is_some()),
        ] {
            if is_set && !secure {
                return Err((
                    key,
                    "the source is not secured by TLS: https:// or rtsps://".to_owned(),
                ));
            }
        }
        if camera.ca_file.is_some() && camera.fingerprint.is_some() {
            return Err(("camera.fingerprint", "give ca_file or fingerprint, not both".to_owned()));
        }
        if let Some(Err(reason)) = camera.fingerprint.as_deref().map(Trust::fingerprint) {
            return Err(("camera.fingerprint", reason));
        }
        Ok(())
    }
}
