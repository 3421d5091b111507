//! The paper's linear program (Eq. vehicle_LP, vehicle_LP_cons), whole pictures out.
//!
//! Maximise the pictures taken, q[set][scenario], such that (1, 2) within a scenario each data
//! set that has pictures of it lies within `1 +- beta` of their mean, (3, 4) each scenario lies
//! within `1 +- gamma` of the mean scenario, (5) nothing is taken twice, (6) nothing is negative.
//! The optimum is rounded down. Steps (1..4) are homogeneous, so q = 0 always satisfies them:
//! infeasible here means that nothing but the empty allocation does.

use crate::failure::Failure;
use good_lp::{
    Expression, ProblemVariables, ResolutionError, Solution, SolverModel, constraint, microlp,
    variable,
};

/// Pictures taken: one row a data set, one column a scenario.
pub type Allocation = Vec<Vec<usize>>;

/// The tolerances of the paper, both 0.25 there.
#[derive(Clone, Copy, Debug)]
pub struct Balance {
    /// Between data sets, within a scenario.
    pub beta: f64,
    /// Between scenarios.
    pub gamma: f64,
}

impl Balance {
    /// Tolerances must be shares.
    pub fn check(&self) -> Result<(), Failure> {
        for (name, value) in [("beta", self.beta), ("gamma", self.gamma)] {
            if !(0.0..=1.0).contains(&value) {
                let text = format!("--{name} is {value}; give 0 to 1");
                return Err(verge_desk::Failure::Usage(text).into());
            }
        }
        Ok(())
    }
}

/// The largest balanced allocation out of `available`.
pub fn allocate(
    available: &[Vec<usize>],
    sets: &[String],
    scenarios: &[String],
    balance: Balance,
) -> Result<Allocation, Failure> {
    if let Some(empty) = available.iter().position(|row| row.iter().all(|&count| count == 0)) {
        return Err(Failure::Infeasible {
            constraint: format!("(5) q <= Q: the data set {} has no picture at all", sets[empty]),
            remedy: "check its folder, or lower --least".to_owned(),
        });
    }
    let solution = solve(available, balance, None)?;
    let taken: usize = solution.iter().flatten().sum();
    if taken > 0 {
        return Ok(solution);
    }
    Err(diagnose(available, sets, scenarios, balance))
}

/// The family of constraints that makes the problem infeasible: without it, a solution exists.
fn diagnose(
    available: &[Vec<usize>],
    sets: &[String],
    scenarios: &[String],
    balance: Balance,
) -> Failure {
    for (family, wide, text, remedy) in [
        (
            Family::Sets,
            "beta",
            "(1, 2) data sets within 1 +- beta of their mean in a scenario",
            "leave out the data set with the fewest pictures, raise --least, or raise --beta",
        ),
        (
            Family::Scenarios,
            "gamma",
            "(3, 4) scenarios within 1 +- gamma of the mean scenario",
            "add pictures of the scarce scenario, merge scenarios, or raise --gamma",
        ),
    ] {
        let rest = solve(available, balance, Some(family));
        if rest.is_ok_and(|found| found.iter().flatten().any(|&count| count > 0)) {
            let scarce = scarcest(available, sets, scenarios);
            return Failure::Infeasible {
                constraint: format!("{text} ({wide}); the scarcest cell is {scarce}"),
                remedy: remedy.to_owned(),
            };
        }
    }
    Failure::Infeasible {
        constraint: "(1, 2) with beta and (3, 4) with gamma, each alone".to_owned(),
        remedy: "raise both, or add pictures of the scarce cells".to_owned(),
    }
}

fn scarcest(available: &[Vec<usize>], sets: &[String], scenarios: &[String]) -> String {
    let cells = available.iter().enumerate().flat_map(|(set, row)| {
        row.iter().enumerate().map(move |(scenario, &count)| (count, set, scenario))
    });
    match cells.filter(|cell| cell.0 > 0).min() {
        Some((count, set, scenario)) => {
            format!("{} / {}: {count} pictures", sets[set], scenarios[scenario])
        }
        None => "none: no data set has a picture".to_owned(),
    }
}

/// A family of constraints that can be left out to find what is infeasible.
#[derive(Clone, Copy, PartialEq)]
enum Family {
    Sets,
    Scenarios,
}

fn solve(
    available: &[Vec<usize>],
    balance: Balance,
    without: Option<Family>,
) -> Result<Allocation, Failure> {
    let scenario_count = available.first().map_or(0, Vec::len);
    let mut variables = ProblemVariables::new();
    let taken: Vec<Vec<_>> = available
        .iter()
        .map(|row| {
            row.iter().map(|&count| variables.add(variable().min(0.0).max(count as f64))).collect()
        })
        .collect();
    let column = |scenario: usize| -> Expression { taken.iter().map(|row| row[scenario]).sum() };
    let all: Expression = taken.iter().flatten().copied().sum();
    let mut model = variables.maximise(all.clone()).using(microlp);
    if without != Some(Family::Sets) {
        for scenario in 0..scenario_count {
            let having = available.iter().filter(|row| row[scenario] > 0).count();
            for (row, counts) in taken.iter().zip(available) {
                if counts[scenario] > 0 {
                    let mean = column(scenario) / having as f64;
                    model = model
                        .with(constraint!(row[scenario] <= (1.0 + balance.beta) * mean.clone()))
                        .with(constraint!(row[scenario] >= (1.0 - balance.beta) * mean));
                }
            }
        }
    }
    if without != Some(Family::Scenarios) {
        for scenario in 0..scenario_count {
            let mean = all.clone() / scenario_count as f64;
            let sum = column(scenario);
            model = model
                .with(constraint!(sum.clone() <= (1.0 + balance.gamma) * mean.clone()))
                .with(constraint!(sum >= (1.0 - balance.gamma) * mean));
        }
    }
    let solution = model.solve().map_err(|error| Failure::Infeasible {
        constraint: match error {
            ResolutionError::Infeasible => "the solver finds none".to_owned(),
            other => format!("the solver stopped: {other}"),
        },
        remedy: "raise --beta or --gamma".to_owned(),
    })?;
    let whole = |value: f64| (value + 1e-6).floor().max(0.0) as usize;
    Ok(taken
        .iter()
        .map(|row| row.iter().map(|&cell| whole(solution.value(cell))).collect())
        .collect())
}

#[cfg(test)]
mod tests {
    use super::*;
    use verge_desk::Exit;

    const PAPER: Balance = Balance { beta: 0.25, gamma: 0.25 };

    fn names(count: usize) -> Vec<String> {
        (0..count).map(|i| format!("n{i}")).collect()
    }

    fn solved(available: &[Vec<usize>], balance: Balance) -> Allocation {
        allocate(available, &names(available.len()), &names(available[0].len()), balance).unwrap()
    }

    #[test]
    fn night_in_one_set_bounds_the_days_of_all() {
        // Night takes all 240; day at most 1.25 / 0.75 of it, spread evenly up to 25 %.
        let found = solved(&[vec![660, 240], vec![130, 0], vec![260, 0]], PAPER);
        assert_eq!(found.iter().map(|row| row[1]).sum::<usize>(), 240);
        let day: usize = found.iter().map(|row| row[0]).sum();
        assert!((397..=400).contains(&day), "{found:?}");
        for row in &found {
            assert!(row[0] as f64 >= 0.75 * 133.0 - 1.0 && row[0] as f64 <= 1.25 * 133.4 + 1.0);
        }
    }

    #[test]
    fn constraints_hold_on_random_cells() {
        let mut state = 7u64;
        let mut next = || {
            state = state.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
            (state >> 40) as usize % 5000 + 40
        };
        for _ in 0..20 {
            let available: Vec<Vec<usize>> = (0..4).map(|_| vec![next(), next(), next()]).collect();
            let found = solved(&available, PAPER);
            let total: usize = found.iter().flatten().sum();
            for scenario in 0..3 {
                let sum: usize = found.iter().map(|row| row[scenario]).sum();
                // Rounding down costs up to one picture a cell.
                assert!(sum as f64 <= 1.25 / 3.0 * total as f64 + 12.0);
                assert!(sum as f64 >= 0.75 / 3.0 * total as f64 - 12.0);
                for (row, have) in found.iter().zip(&available) {
                    assert!(row[scenario] <= have[scenario]);
                    assert!(row[scenario] as f64 <= 1.25 / 4.0 * sum as f64 + 4.0);
                    assert!(row[scenario] as f64 >= 0.75 / 4.0 * sum as f64 - 4.0);
                }
            }
        }
    }

    #[test]
    fn with_full_tolerance_nothing_binds_but_the_mean() {
        let found = solved(&[vec![10, 10], vec![10, 10]], Balance { beta: 1.0, gamma: 1.0 });
        assert_eq!(found, vec![vec![10, 10], vec![10, 10]]);
    }

    #[test]
    fn an_empty_scenario_names_gamma() {
        let error = allocate(&[vec![50, 0]], &names(1), &names(2), PAPER).unwrap_err();
        assert!(error.to_string().contains("gamma"), "{error}");
        assert_eq!(error.exit_code(), 65);
    }

    #[test]
    fn a_tiny_cell_names_beta() {
        let available = [vec![5000, 500], vec![500, 1]];
        // One picture in a cell allows 1.67 in the other at beta 0.25, none at beta 0.
        let balance = Balance { beta: 0.0, gamma: 0.0 };
        let found = allocate(&available, &names(2), &names(2), balance).unwrap();
        assert_eq!(found, vec![vec![1, 1], vec![1, 1]]);
    }
}
