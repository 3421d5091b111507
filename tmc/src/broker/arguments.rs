//! How the command line names a broker.

use super::{Settings, tls};
use crate::failure::Failure;
use std::path::{Path, PathBuf};

/// The broker, and how to log in.
#[derive(clap::Args, Clone, Debug)]
pub struct BrokerArguments {
    /// The broker.
    #[arg(long, value_name = "HOST:PORT", default_value = "127.0.0.1:1883")]
    broker: String,
    /// Topic above the sites' own.
    #[arg(long, default_value = "verge")]
    pub root: String,
    /// User at the broker; the password stands in the file.
    #[arg(long, requires = "password_file")]
    user: Option<String>,
    /// File with the password, which its owner alone may read.
    #[arg(long, value_name = "FILE", requires = "user")]
    password_file: Option<PathBuf>,
    /// TLS to the broker, whose certificate an authority in this PEM file has signed.
    #[arg(long, value_name = "FILE")]
    ca: Option<PathBuf>,
    /// Certificate of this program for the broker, PEM.
    #[arg(long, value_name = "FILE", requires_all = ["key", "ca"])]
    cert: Option<PathBuf>,
    /// Its key, PEM, which its owner alone may read.
    #[arg(long, value_name = "FILE", requires = "cert")]
    key: Option<PathBuf>,
}

impl BrokerArguments {
    /// The connection of `name` to these topics; `is_kept` by the broker while the program is away.
    ///
    /// # Errors
    /// [`Failure`]: an address that is none, files that cannot be read or that others may read.
    pub fn settings(
        &self,
        name: &str,
        filters: Vec<String>,
        is_kept: bool,
    ) -> Result<Settings, Failure> {
        let address = &self.broker;
        let (host, port) = address
            .rsplit_once(':')
            .and_then(|(host, port)| Some((host.to_owned(), port.parse().ok()?)))
            .ok_or_else(|| Failure::usage(format!("--broker {address:?}: give HOST:PORT")))?;
        let credentials = match (&self.user, &self.password_file) {
            (Some(user), Some(path)) => {
                only_the_owner_reads(path)?;
                let text = verge_desk::read_text(path)?;
                Some((user.clone(), text.trim_end_matches(['\r', '\n']).to_owned()))
            }
            _ => None,
        };
        let client = self.cert.as_deref().zip(self.key.as_deref());
        client.map_or(Ok(()), |(_, key)| only_the_owner_reads(key))?;
        let tls = self.ca.as_deref().map(|ca| tls::load(ca, client)).transpose()?;
        let is_here = ["localhost", "127.0.0.1", "::1", "[::1]"].contains(&host.as_str());
        if credentials.is_some() && tls.is_none() && !is_here {
            eprintln!("verge-tmc: the password goes to {host} in clear: give --ca for TLS");
        }
        let name = name.to_owned();
        Ok(Settings { host, port, name, credentials, tls, filters, is_kept })
    }
}

/// Refuses a secret that others may read.
fn only_the_owner_reads(path: &Path) -> Result<(), verge_desk::Failure> {
    use std::os::unix::fs::PermissionsExt;
    use verge_desk::Failure;
    let mode = std::fs::metadata(path).map_err(|source| Failure::reading(path, source))?;
    if mode.permissions().mode() & 0o077 == 0 {
        return Ok(());
    }
    Err(Failure::content(path, 0, "others may read it: chmod 600"))
}
