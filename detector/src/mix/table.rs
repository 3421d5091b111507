//! The allocation as the paper prints it (Table dataset_detection), with what was there.

use super::Allocation;

/// A line a data set, a column a scenario: `taken of available`, then totals.
pub fn print(
    sets: &[String],
    scenarios: &[String],
    taken: &Allocation,
    available: &[Vec<usize>],
) -> String {
    let mut rows = vec![
        std::iter::once("Dataset".to_owned())
            .chain(scenarios.iter().map(|name| format!("# images in {name}")))
            .chain(["Total # images".to_owned()])
            .collect::<Vec<_>>(),
    ];
    let cell = |taken: usize, there: usize| format!("{taken} of {there}");
    for ((set, taken), there) in sets.iter().zip(taken).zip(available) {
        let mut row = vec![set.clone()];
        row.extend(taken.iter().zip(there).map(|(&taken, &there)| cell(taken, there)));
        row.push(cell(taken.iter().sum(), there.iter().sum()));
        rows.push(row);
    }
    let column = |table: &[Vec<usize>], i: usize| table.iter().map(|row| row[i]).sum::<usize>();
    let mut row = vec!["Total".to_owned()];
    row.extend((0..scenarios.len()).map(|i| cell(column(taken, i), column(available, i))));
    row.push(cell(taken.iter().flatten().sum(), available.iter().flatten().sum()));
    rows.push(row);
    let width = |i: usize| rows.iter().map(|row| row[i].len()).max().unwrap_or(0);
    let widths: Vec<usize> = (0..rows[0].len()).map(width).collect();
    let mut text = String::new();
    for row in &rows {
        for (i, (field, &width)) in row.iter().zip(&widths).enumerate() {
            let padded =
                if i == 0 { format!("{field:<width$}") } else { format!("  {field:>width$}") };
            text += &padded;
        }
        text += "\n";
    }
    text
}
