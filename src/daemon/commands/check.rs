//! `verge check`: every part of a configuration is tried, one line per check.

use crate::daemon::config::Config;
use crate::daemon::exit::{self, Failure};
use crate::daemon::publish;
use crate::daemon::{broker, first_picture, open_line};
use std::path::Path;

pub fn run(path: &Path) -> Result<(), Failure> {
    let mut report = Report::default();
    let Some(config) = report.line("config", Config::read(path), |config| {
        format!(
            "{}: site {}, windows {:?} s",
            path.display(),
            config.site,
            config.windows.lengths_s
        )
    }) else {
        return report.finish();
    };
    let line = open_line(&config);
    let line = report.line("model and table", line, |line| {
        let (model, table) = line.describe();
        format!("{model}; {table}")
    });
    let frame = report.line("camera", first_picture(&config, line.as_ref()), |frame| {
        format!("{}: {}x{} px", config.camera.source, frame.picture.width, frame.picture.height)
    });
    if let (Some(mut line), Some(frame)) = (line, frame) {
        let measured = line.measure(&frame).map(|_| line);
        report.line("measurement", measured, |line| {
            let (found, located) = line.latest();
            format!("{found} vehicles found, {located} of them in the lanes")
        });
    }
    let connected = broker(&config).and_then(|settings| {
        publish::probe(&settings).map_err(|reason| Failure::Broker {
            host: settings.host.clone(),
            port: settings.port,
            reason,
        })
    });
    report.line("broker", connected, |()| {
        format!("{}:{}, topics under {}", config.mqtt.host, config.mqtt.port, config.root_topic())
    });
    report.finish()
}

#[derive(Default)]
struct Report {
    checks: usize,
    failed: usize,
    code: Option<u8>,
}

impl Report {
    /// Prints one check and passes its value on.
    fn line<T, E: Into<Failure>>(
        &mut self,
        name: &str,
        outcome: Result<T, E>,
        describe: impl FnOnce(&T) -> String,
    ) -> Option<T> {
        self.checks += 1;
        match outcome.map_err(Into::into) {
            Ok(value) => {
                println!("ok    {name}: {}", describe(&value));
                Some(value)
            }
            Err(failure) => {
                println!("FAIL  {name}: {failure}");
                self.failed += 1;
                self.code.get_or_insert(failure.code());
                None
            }
        }
    }

    fn finish(self) -> Result<(), Failure> {
        let Self { checks, failed, code } = self;
        if failed == 0 {
            return Ok(());
        }
        Err(Failure::Checks { failed, checks, code: code.unwrap_or(exit::SOFTWARE) })
    }
}
