//! `mvcalib desk`: the page in the browser.
//!
//! Owns finding the pictures, the detector and its model. Does not own the page nor the work.

use super::print;
use mvcalib::desk::collect::Camera;
use mvcalib::desk::program::Detector;
use mvcalib::desk::server::Desk;
use mvcalib::desk::site::{Site, source};
use mvcalib::desk::traffic::Traffic;
use mvcalib::error::{Error, Result};
use std::path::{Path, PathBuf};

/// Where the model lies, from the working directory and in the package.
const MODELS: [&str; 2] =
    ["models/verge_nanodet_640x480.toml", "/usr/share/verge/models/verge_nanodet_640x480.toml"];

/// Arguments of `desk`.
#[derive(Debug, clap::Args)]
pub struct Arguments {
    /// Folder with pictures of one camera, or with a folder `frames` of them.
    #[arg(value_name = "FOLDER", required_unless_present_any = ["frames", "camera"])]
    folder: Option<PathBuf>,
    /// The same, by name.
    #[arg(long, value_name = "DIR", conflicts_with = "folder")]
    frames: Option<PathBuf>,
    /// A camera whose pictures are collected on the page, into FOLDER's `frames` [FOLDER by
    /// default: named after the camera's host]: http://, mjpeg+http://, rtsp:// (with s for TLS), a
    /// device under /dev, or - to read the address from standard input.
    #[arg(long, value_name = "ADDRESS")]
    camera: Option<String>,
    /// Where the site is saved and opened again [default: the folder's `site`].
    #[arg(long, value_name = "DIR")]
    site: Option<PathBuf>,
    /// Port on loopback; a free one by default.
    #[arg(long, default_value_t = 0)]
    port: u16,
    /// Model of the detector, for its vehicles in the lanes and for `verge.toml`.
    #[arg(long, value_name = "FILE")]
    model: Option<PathBuf>,
    /// The program `verge`; by default beside this one, or on the path.
    #[arg(long, value_name = "FILE")]
    verge: Option<PathBuf>,
    /// Boxes of the pictures that `verge detect` wrote before.
    #[arg(long, value_name = "FILE")]
    detections: Option<PathBuf>,
}

/// Runs `desk` until it is stopped.
pub fn run(arguments: &Arguments) -> Result<()> {
    let folder = arguments.folder.as_ref().or(arguments.frames.as_ref());
    let camera = arguments.camera()?;
    let site = match (&camera, folder) {
        (Some(camera), folder) => {
            let folder = folder.cloned().unwrap_or_else(|| folder_of(camera));
            Site::of_camera(&folder, arguments.site.as_deref())?
        }
        (None, Some(folder)) => Site::of(folder, arguments.site.as_deref())?,
        (None, None) => return Err(Error::Usage("give a folder of pictures, or a camera".into())),
    };
    let detector = arguments.detector()?;
    let traffic = Traffic::new(detector.clone(), &site, arguments.detections.as_deref())?;
    if let Some(said) = traffic.state().problem {
        verge_desk::say(&format!("mvcalib: {said}"));
    }
    let desk = Desk::bind(site, arguments.port, detector, traffic, camera)?;
    print(&desk.address());
    verge_desk::say("open this address in a browser; Ctrl-C ends the desk");
    desk.serve();
    Ok(())
}

impl Arguments {
    /// The camera, with the program that asks it.
    fn camera(&self) -> Result<Option<Camera>> {
        let address = match self.camera.as_deref() {
            None => return Ok(None),
            Some("-") => {
                std::io::stdin().lines().next().and_then(std::io::Result::ok).unwrap_or_default()
            }
            Some(address) => address.to_owned(),
        };
        source::camera(&address).map_err(|why| Error::Usage(format!("--camera: {why}")))?;
        let program = self.program().ok_or_else(|| {
            Error::Usage(
                "the program `verge` asks the camera, and is neither beside this one nor on the \
                 path: give it by --verge FILE"
                    .into(),
            )
        })?;
        Ok(Some(Camera { program, address: address.trim().to_owned() }))
    }

    /// The program `verge`.
    fn program(&self) -> Option<PathBuf> {
        let beside = std::env::current_exe().ok().and_then(|p| Some(p.parent()?.join("verge")));
        self.verge.clone().or(beside.filter(|path| path.is_file())).or_else(on_path)
    }

    /// The detector, where both its program and its model are there.
    fn detector(&self) -> Result<Option<Detector>> {
        let there = |path: &PathBuf| path.is_file();
        if let Some(missing) = [&self.model, &self.verge].into_iter().flatten().find(|p| !there(p))
        {
            return Err(Error::Usage(format!("there is no file {}", missing.display())));
        }
        let model =
            self.model.clone().or_else(|| MODELS.map(PathBuf::from).into_iter().find(there));
        Ok(self.program().zip(model).map(|(program, model)| Detector { program, model }))
    }
}

/// A folder named after the camera's host.
fn folder_of(camera: &Camera) -> PathBuf {
    let shown = camera.shown();
    let host = shown.split_once("://").map_or(shown.as_str(), |(_, rest)| rest);
    let host = host.split(['/', '?']).find(|part| !part.is_empty()).unwrap_or("camera");
    let plain = |c: char| if c.is_ascii_alphanumeric() || c == '.' || c == '-' { c } else { '-' };
    host.chars().map(plain).collect::<String>().trim_start_matches('.').into()
}

fn on_path() -> Option<PathBuf> {
    let path = std::env::var_os("PATH")?;
    std::env::split_paths(&path).map(|p| p.join("verge")).find(|p| Path::is_file(p))
}
