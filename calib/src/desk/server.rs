//! The desk's addresses: what is answered to the page.
//!
//! Owns the table of addresses, and what is made once from the pictures and kept. Does not own
//! what is behind them, nor HTTP and who is refused (see `verge_desk::loopback`).

use super::audit::{Answer, Audit};
use super::backdrop::{Backdrop, Shift, name_of};
use super::collect::{Camera, Collection, Pace};
use super::dashes::{LineDashes, dashes};
use super::draft::{self, Draft};
use super::drawing::Drawing;
use super::look::look;
use super::page;
use super::program::Detector;
use super::save::{interval_of, save};
use super::site::{Opened, POSE, Site};
use super::traffic::{Traffic, count};
use crate::error::{Error, Result};
use crate::model::KEY_POINT_NAMES;
use crate::road::standards;
use serde::Serialize;
use serde::de::DeserializeOwned;
use serde_json::{Value, json};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use verge_desk::loopback::{Asked, Loopback, Reply, decoded};

/// A desk that answers.
pub struct Desk {
    loopback: Loopback,
    site: Site,
    traffic: Traffic,
    audit: Audit,
    collection: Collection,
    detector: Option<Detector>,
    /// What was made of the pictures; made again once others were collected.
    prepared: Mutex<Option<Arc<Prepared>>>,
    latest: Mutex<Latest>,
}

/// The drawing that the page sent last: a page that is loaded again goes on with it, and so does a
/// program that is started again.
#[derive(Default)]
struct Latest {
    drawing: Option<Drawing>,
    /// What this program has saved.
    saved: Option<Drawing>,
    /// What became of a drawing on other pictures that was not saved.
    aside: Option<String>,
    /// How often this site was saved since the program began.
    version: u64,
}

/// What is made once from the pictures.
struct Prepared {
    backdrop: Backdrop,
    /// What was saved before, or why the site's folder must not be written.
    opened: std::result::Result<Option<Opened>, String>,
}

impl Desk {
    /// Binds a port of loopback; 0 takes a free one.
    ///
    /// # Errors
    /// Where the port is taken.
    pub fn bind(
        site: Site,
        port: u16,
        detector: Option<Detector>,
        traffic: Traffic,
        camera: Option<Camera>,
    ) -> Result<Self> {
        let loopback = Loopback::bind(port).map_err(Error::Usage)?;
        let (audit, collection) = (Audit::new(detector.clone()), Collection::new(camera));
        let prepared = Mutex::new(None);
        let latest = Mutex::default();
        Ok(Desk { loopback, site, traffic, audit, collection, detector, prepared, latest })
    }

    /// The address to open in a browser.
    pub fn address(&self) -> String {
        self.loopback.address()
    }

    /// Answers until the process ends.
    pub fn serve(self) {
        self.loopback.serve(|asked| match asked {
            Asked::Get(path) => self.get(path),
            Asked::Post(path, body) => self.post(path, &body),
        });
    }

    fn get(&self, path: &str) -> Reply {
        match path {
            "" => Reply::of("text/html; charset=utf-8", page::INDEX),
            "api/site" => answer(self.site_json()),
            "api/backdrop.png" => {
                bytes("image/png", self.prepared().map(|p| p.backdrop.png.clone()))
            }
            "api/pose.png" => bytes(
                "image/png",
                verge_desk::read_bytes(&self.site.file(POSE)).map_err(Error::from),
            ),
            "api/traffic" => json_of(&self.traffic.state()),
            "api/audit" => json_of(&self.audit.state(&self.site)),
            "api/collect" => json_of(&self.collection.state(&self.site)),
            _ => self.named(path),
        }
    }

    /// Files of the page, and pictures by their name.
    fn named(&self, path: &str) -> Reply {
        if let Some(name) = path.strip_prefix("page/") {
            return page::find(name).map_or_else(Reply::missing, |(media, t)| Reply::of(media, t));
        }
        let (what, name) = path.rsplit_once('/').unwrap_or_default();
        let found = decoded(name).and_then(|name| self.site.picture(&name));
        let Some(file) = found else { return Reply::missing() };
        match what {
            "api/picture" => {
                let is_png = file.extension().is_some_and(|e| e.eq_ignore_ascii_case("png"));
                let media = if is_png { "image/png" } else { "image/jpeg" };
                bytes(media, verge_desk::read_bytes(&file).map_err(Error::from))
            }
            "api/shift" => answer(
                self.prepared().and_then(|p| p.backdrop.shift(&file)).map(|s| shift_json(&s)),
            ),
            _ => Reply::missing(),
        }
    }

    fn post(&self, path: &str, body: &[u8]) -> Reply {
        match path {
            "api/traffic" => {
                return answer(self.traffic.start(&self.site).map(|()| self.traffic.state()));
            }
            "api/audit/choose" => return self.audited(self.audit.choose(&self.site)),
            "api/audit/compare" => {
                let answers = parsed::<Vec<Answer>>(body);
                let begun = answers.and_then(|answers| self.audit.compare(&self.site, &answers));
                return self.audited(begun);
            }
            "api/collect" => {
                let begun =
                    parsed::<Pace>(body).and_then(|pace| self.collection.start(&self.site, pace));
                return answer(begun.map(|()| self.collection.state(&self.site)));
            }
            "api/draft/drop" => {
                self.drop_draft();
                return json_of(&json!({}));
            }
            "api/collect/stop" => {
                self.collection.stop();
                return json_of(&self.collection.state(&self.site));
            }
            "api/collect/use" => {
                self.forget();
                return json_of(&self.collection.state(&self.site));
            }
            _ => {}
        }
        let drawing = match Drawing::parse(body) {
            Ok(drawing) => drawing,
            Err(why) => return wrong(&format!("the drawing: {why}")),
        };
        if let Some(version) = path.strip_prefix("api/save/") {
            return answer(self.save(drawing, version));
        }
        if let Some(version) = path.strip_prefix("api/look/") {
            // Before the fit, which takes a while: a later drawing must not be overtaken.
            self.keep(&drawing, version);
            return json_of(&look(&drawing, &self.traffic.cue()));
        }
        match path {
            "api/dashes" => answer(self.dashes(&drawing)),
            "api/count" => answer(
                self.prepared()
                    .and_then(|p| count(&drawing, &self.traffic, &p.backdrop, &self.site)),
            ),
            _ => Reply::missing(),
        }
    }

    fn dashes(&self, drawing: &Drawing) -> Result<Vec<LineDashes>> {
        dashes(drawing, &self.traffic.cue(), &self.prepared()?.backdrop)
    }

    fn audited(&self, begun: Result<()>) -> Reply {
        answer(begun.map(|()| self.audit.state(&self.site)))
    }

    /// Saves what goes on from `version`, so that no window undoes what another has saved.
    fn save(&self, drawing: Drawing, version: &str) -> Result<Value> {
        let prepared = self.prepared()?;
        prepared.opened()?;
        let mut latest = self.latest();
        if version != latest.version.to_string() {
            return Err(Error::Usage(
                "another window has saved this site since you opened this page: reload the page to \
                 continue from there; what you drew here since then will be lost"
                    .into(),
            ));
        }
        let model = self.detector.as_ref().map(|d| d.model.as_path());
        let saved = save(&drawing, &self.site, &prepared.backdrop, &self.traffic, model)?;
        draft::drop(&self.site);
        let version = latest.version + 1;
        let (copy, aside) = (drawing.clone(), latest.aside.take());
        *latest = Latest { drawing: Some(copy), saved: Some(drawing), aside, version };
        Ok(json!({ "folder": saved.folder, "files": saved.files, "version": version }))
    }

    /// Keeps what goes on from the latest save; a window that another has overtaken keeps its own.
    fn keep(&self, drawing: &Drawing, version: &str) {
        let may_be_written = self.prepared().is_ok_and(|p| p.opened.is_ok());
        let mut latest = self.latest();
        let is_old = version != latest.version.to_string();
        if is_old || !may_be_written || latest.drawing.as_ref() == Some(drawing) {
            return;
        }
        // The first one is what the page was loaded with.
        if latest.drawing.is_some() {
            draft::keep(&self.site, drawing);
        }
        latest.drawing = Some(drawing.clone());
    }

    /// Goes back to what was saved.
    fn drop_draft(&self) {
        let mut latest = self.latest();
        latest.drawing = latest.saved.clone();
        // What the page still sends is of the drawing that was dropped.
        latest.version += 1;
        draft::drop(&self.site);
    }

    /// Takes up what was drawn on these pictures and not saved before the program ended. What was
    /// drawn on others is set aside, where the folder may be written.
    fn take_up(&self, prepared: &Prepared) {
        let mut latest = self.latest();
        if prepared.opened.is_err() {
            return;
        }
        match draft::find(&self.site, &prepared.backdrop.sha256) {
            Draft::Here(drawing) if latest.drawing.is_none() => latest.drawing = Some(*drawing),
            Draft::Aside(said) => {
                latest.drawing.take_if(|d| d.backdrop != prepared.backdrop.sha256);
                latest.aside = Some(said);
            }
            Draft::Here(_) | Draft::None => {}
        }
    }

    fn latest(&self) -> MutexGuard<'_, Latest> {
        self.latest.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn prepared(&self) -> Result<Arc<Prepared>> {
        let mut kept = self.prepared.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(prepared) = &*kept {
            return Ok(Arc::clone(prepared));
        }
        let backdrop = Backdrop::of(&self.site.pictures()?)?;
        let opened = self.site.open(&backdrop).map_err(|e| e.to_string());
        Ok(Arc::clone(kept.insert(Arc::new(Prepared { backdrop, opened }))))
    }

    /// There are other pictures now.
    fn forget(&self) {
        *self.prepared.lock().unwrap_or_else(PoisonError::into_inner) = None;
    }

    fn site_json(&self) -> Result<Value> {
        let prepared = self.prepared()?;
        let (backdrop, opened) = (&prepared.backdrop, prepared.opened());
        let problem = opened.as_ref().err().map(ToString::to_string);
        let opened = opened.ok().flatten();
        let empty = || Drawing::empty(backdrop.image_size, backdrop.sha256.clone());
        self.take_up(&prepared);
        let latest = self.latest();
        // One on other pictures is not on these.
        let here = |d: &&Drawing| d.backdrop == backdrop.sha256;
        let drawn = latest.drawing.as_ref().filter(here);
        let saved = latest.saved.as_ref().filter(here).or(opened.map(|o| &o.drawing));
        let is_draft = drawn.is_some_and(|d| saved.map_or(!d.is_bare(), |s| s != d));
        let moved = opened.filter(|_| drawn.is_none()).and_then(|o| o.moved.as_ref());
        let drawing = drawn.or(saved).cloned().unwrap_or_else(empty);
        let frames: Vec<String> = self.site.pictures()?.iter().map(|p| name_of(p)).collect();
        let standards: Vec<Value> = standards::all()
            .iter()
            .map(|s| json!({"name": s.name, "what": s.what, "pitch_m": s.pitch_m()}))
            .collect();
        Ok(json!({
            "folder": self.site.folder.display().to_string(),
            "frames": frames,
            "used": backdrop.frames.iter().map(|p| name_of(p)).collect::<Vec<_>>(),
            "left_out": backdrop.left_out,
            "image_size": backdrop.image_size,
            "backdrop": backdrop.sha256,
            "drawing": drawing,
            "saved": saved.is_some() && !is_draft,
            "draft": is_draft,
            "aside": latest.aside,
            "version": latest.version,
            "moved": moved.map(shift_json),
            "problem": problem,
            "standards": standards,
            "key_points": KEY_POINT_NAMES,
            "interval_s": interval_of(&self.site),
            "traffic": self.traffic.state(),
            "camera": self.collection.camera(),
            "source": self.collection.source(),
        }))
    }
}

impl Prepared {
    fn opened(&self) -> Result<Option<&Opened>> {
        self.opened.as_ref().map(Option::as_ref).map_err(|why| Error::Usage(why.clone()))
    }
}

fn json_of(value: &impl Serialize) -> Reply {
    Reply::json(serde_json::to_vec(value).expect("answers are made of finite numbers and text"))
}

fn wrong(error: &impl std::fmt::Display) -> Reply {
    Reply::refused(json!({ "error": error.to_string() }).to_string())
}

fn answer(result: Result<impl Serialize>) -> Reply {
    result.map_or_else(|e| wrong(&e), |value| json_of(&value))
}

fn bytes(media: &str, result: Result<Vec<u8>>) -> Reply {
    result.map_or_else(|e| wrong(&e), |bytes| Reply::of(media, bytes))
}

fn parsed<T: DeserializeOwned>(body: &[u8]) -> Result<T> {
    serde_json::from_slice(body).map_err(|e| Error::Usage(format!("what the page sent: {e}")))
}

fn shift_json(shift: &Shift) -> Value {
    json!({
        "by": shift.by,
        "turn_deg": shift.turn.to_degrees(),
        "zoom": shift.zoom,
        "displacement_px": shift.displacement_px,
        "sure": shift.sure,
    })
}
