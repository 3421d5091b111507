//! The audit of a site: what people count there, against what the line counts.
//!
//! Owns the choice of frames, the answers, what follows from them, and the site's own file. Does
//! not measure: the command gives it what the line counted.

mod answers;
mod choice;
mod fit;
mod site;

pub use answers::{Answers, AnswersError, SHEET, template};
pub use choice::{Candidate, choose};
pub use fit::{Counted, FitError, LEAST_FRAMES, fit};
pub use site::{FORMAT, MadeWith, SiteError, SiteFile};
