//! In which order people write day, month and year.
//!
//! Owns the orders. Names of files are read by them in `capture`.

/// In which order a date that does not tell by itself is read.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub enum Dates {
    /// 26-01-05 is 5 January 2026
    YearFirst,
    /// 05-01-2026 and 05-01-26 are 5 January 2026
    DayFirst,
    /// 05-01-2026 and 05-01-26 are 1 May 2026
    MonthFirst,
}

impl Dates {
    /// All of them.
    pub const ALL: [Self; 3] = [Self::YearFirst, Self::DayFirst, Self::MonthFirst];

    /// For people.
    pub const fn words(self) -> &'static str {
        match self {
            Self::YearFirst => "year first (26-01-05)",
            Self::DayFirst => "day first (05-01-2026)",
            Self::MonthFirst => "month first (01-05-2026)",
        }
    }
}
