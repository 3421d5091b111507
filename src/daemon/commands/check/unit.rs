//! Systemd's sandbox around the service, read out of the unit and its drop-ins.
//!
//! Owns which of a configuration's places lie outside of it. `check` runs beside the service, not in
//! it: without this it would pass where the service may not write.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// Folders of units, the first that has one wins.
const FOLDERS: [&str; 5] = [
    "etc/systemd/system",
    "run/systemd/system",
    "usr/local/lib/systemd/system",
    "usr/lib/systemd/system",
    "lib/systemd/system",
];
const UNIT: &str = "verge.service";
/// Folders that systemd makes for a service, by the setting that names them.
const MADE: [(&str, &str); 5] = [
    ("StateDirectory", "/var/lib"),
    ("RuntimeDirectory", "/run"),
    ("CacheDirectory", "/var/cache"),
    ("LogsDirectory", "/var/log"),
    ("ConfigurationDirectory", "/etc"),
];
/// Folders of people, which `ProtectHome` hides.
const HOMES: [&str; 3] = ["/home", "/root", "/run/user"];
/// Folders that `PrivateTmp` gives each service of its own.
const TEMPORARY: [&str; 2] = ["/tmp", "/var/tmp"];
/// Not files of a disk; `ProtectSystem` leaves them alone.
const OF_THE_KERNEL: [&str; 3] = ["/dev", "/proc", "/sys"];

/// The service's rights to files.
#[derive(Debug, Default, PartialEq, Eq)]
pub(super) struct Sandbox {
    /// `ProtectSystem`.
    system: String,
    /// `ProtectHome`.
    home: String,
    private_tmp: bool,
    writable: Vec<PathBuf>,
    /// Seen although `ProtectHome` or `PrivateTmp` hides what is around them.
    bound: Vec<PathBuf>,
}

impl Sandbox {
    /// Of the unit below `root`; `None` where none is installed.
    pub(super) fn read(root: &Path) -> Option<Self> {
        let folders = FOLDERS.map(|folder| root.join(folder));
        let unit =
            folders.iter().find_map(|folder| std::fs::read_to_string(folder.join(UNIT)).ok())?;
        // By their names; of two of one name the first folder's counts.
        let mut drop_ins = BTreeMap::new();
        for folder in folders.iter().rev() {
            let entries = std::fs::read_dir(folder.join(format!("{UNIT}.d"))).into_iter().flatten();
            for path in entries.filter_map(|entry| Some(entry.ok()?.path())) {
                let is_one = path.extension().is_some_and(|extension| extension == "conf");
                if let (true, Some(name)) = (is_one, path.file_name()) {
                    let text = std::fs::read_to_string(&path).unwrap_or_default();
                    drop_ins.insert(name.to_owned(), text);
                }
            }
        }
        let mut sandbox = Self::default();
        sandbox.take(&unit);
        drop_ins.values().for_each(|text| sandbox.take(text));
        Some(sandbox)
    }

    /// Takes the settings of one file.
    fn take(&mut self, text: &str) {
        let text = text.replace("\\\n", " ");
        let lines = text.lines().filter(|line| !line.trim_start().starts_with(['#', ';']));
        for (key, value) in lines.filter_map(|line| line.split_once('=')) {
            let (key, value) = (key.trim(), value.trim());
            let paths = || {
                value.split_whitespace().map(|path| {
                    let path = path.trim_matches('"').trim_start_matches(['-', '+']);
                    PathBuf::from(path.split(':').next_back().unwrap_or_default())
                })
            };
            if let Some((_, folder)) = MADE.iter().find(|(made, _)| *made == key) {
                // `name:link` has another name beside it.
                let names = value.split_whitespace().filter_map(|name| name.split(':').next());
                self.writable.extend(names.map(|name| Path::new(folder).join(name)));
            }
            match key {
                "ProtectSystem" => self.system = value.to_lowercase(),
                "ProtectHome" => self.home = value.to_lowercase(),
                "PrivateTmp" => self.private_tmp = !is_off(value),
                "ReadWritePaths" | "ReadWriteDirectories" if value.is_empty() => {
                    self.writable
                        .retain(|path| MADE.iter().any(|(_, made)| path.starts_with(made)));
                }
                "ReadWritePaths" | "ReadWriteDirectories" => self.writable.extend(paths()),
                "BindPaths" => {
                    self.writable.extend(paths());
                    self.bound.extend(paths());
                }
                "BindReadOnlyPaths" => self.bound.extend(paths()),
                _ => {}
            }
        }
    }

    /// Why the service does not see `path`.
    pub(super) fn hides(&self, path: &Path) -> Option<String> {
        let is_bound = |path: &Path| self.bound.iter().any(|bound| path.starts_with(bound));
        let within = |folders: &[&'static str]| {
            folders.iter().copied().find(|folder| path.starts_with(folder) && !is_bound(path))
        };
        if self.private_tmp
            && let Some(folder) = within(&TEMPORARY)
        {
            return Some(format!(
                "the service has a {folder} of its own (PrivateTmp in its unit): move it elsewhere, \
                 /etc/verge for what is read, /run/verge or /var/lib/verge for what is written"
            ));
        }
        let hides_homes = !is_off(&self.home) && self.home != "read-only";
        if hides_homes && let Some(folder) = within(&HOMES) {
            return Some(format!(
                "the service does not see {folder} (ProtectHome in its unit): move it to /etc/verge or \
                 /var/lib/verge"
            ));
        }
        None
    }

    /// Why the service may not write `path`.
    pub(super) fn forbids(&self, path: &Path) -> Option<String> {
        if let Some(reason) = self.hides(path) {
            return Some(reason);
        }
        let is_below = |folders: &[&str]| folders.iter().any(|folder| path.starts_with(folder));
        let is_writable = self.writable.iter().any(|writable| path.starts_with(writable));
        let is_read_only = match self.system.as_str() {
            "strict" => !(is_below(&OF_THE_KERNEL) || self.private_tmp && is_below(&TEMPORARY)),
            "full" => is_below(&["/usr", "/boot", "/efi", "/etc"]),
            value if is_off(value) => false,
            _ => is_below(&["/usr", "/boot", "/efi"]),
        };
        let is_read_only = is_read_only || (self.home == "read-only" && is_below(&HOMES));
        (is_read_only && !is_writable).then(|| {
            let folder = path.parent().unwrap_or(path).display();
            format!(
                "the service may not write there (ProtectSystem in its unit): name a place below \
                 /var/lib/verge or /run/verge, or allow it: `systemctl edit verge`, [Service], \
                 ReadWritePaths={folder}"
            )
        })
    }
}

fn is_off(value: &str) -> bool {
    matches!(value.to_lowercase().as_str(), "" | "no" | "false" | "off" | "0")
}

#[cfg(test)]
mod tests {
    use super::*;

    const SHIPPED: &str = include_str!("../../../../boards/linux/verge.service");

    fn installed(drop_in: &str) -> Sandbox {
        let root = tempfile::tempdir().expect("a temporary folder");
        let write = |path: &str, text: &str| {
            let path = root.path().join(path);
            std::fs::create_dir_all(path.parent().expect("it has one")).expect("made");
            std::fs::write(path, text).expect("written");
        };
        write("usr/lib/systemd/system/verge.service", SHIPPED);
        write("etc/systemd/system/verge.service.d/override.conf", drop_in);
        Sandbox::read(root.path()).expect("it is installed")
    }

    #[test]
    fn the_shipped_unit_writes_its_own_folders_alone() {
        let unit = installed("");
        for path in ["/run/verge/verge.prom", "/var/lib/verge/spool"] {
            assert_eq!(unit.forbids(Path::new(path)), None, "{path}");
        }
        for (path, word) in [
            (
                "/var/lib/prometheus/node-exporter/verge.prom",
                "ReadWritePaths=/var/lib/prometheus/node-exporter",
            ),
            ("/etc/verge/verge.prom", "ProtectSystem"),
            ("/data/spool", "ReadWritePaths=/data"),
            ("/run/vergex/verge.prom", "ProtectSystem"),
            ("/tmp/verge.prom", "PrivateTmp"),
            ("/home/pi/verge.prom", "ProtectHome"),
        ] {
            let said = unit.forbids(Path::new(path)).expect(path);
            assert!(said.contains(word), "{path}: {said}");
        }
        assert!(unit.hides(Path::new("/root/model.toml")).is_some());
        assert!(unit.hides(Path::new("/etc/verge/k109f.lut")).is_none());
        assert!(unit.hides(Path::new("/homes/k109f.lut")).is_none());
    }

    #[test]
    fn drop_ins_change_it() {
        let file = Path::new("/var/lib/prometheus/node-exporter/verge.prom");
        let unit = installed("[Service]\nReadWritePaths=-/data \\\n  /var/lib/prometheus\n");
        assert_eq!(unit.forbids(file), None);
        assert_eq!(unit.forbids(Path::new("/data/spool")), None);
        let unit = installed("[Service]\nProtectSystem=full\n#ProtectHome=no\n");
        assert_eq!(unit.forbids(file), None);
        assert!(unit.forbids(Path::new("/etc/verge/verge.prom")).is_some());
        assert!(unit.hides(Path::new("/home/pi/frames")).is_some(), "a comment changes nothing");
        let unit = installed("[Service]\nProtectHome=no\nPrivateTmp=false\nProtectSystem=off\n");
        for path in ["/home/pi/frames", "/tmp/verge.prom", "/etc/verge/verge.prom"] {
            assert_eq!(unit.forbids(Path::new(path)), None, "{path}");
        }
        let unit = installed("[Service]\nBindReadOnlyPaths=/home/pi/frames\n");
        assert_eq!(unit.hides(Path::new("/home/pi/frames/1.jpg")), None);
        assert!(unit.forbids(Path::new("/home/pi/frames/1.jpg")).is_some());
        let none = tempfile::tempdir().expect("a temporary folder");
        assert_eq!(Sandbox::read(none.path()), None);
    }
}
