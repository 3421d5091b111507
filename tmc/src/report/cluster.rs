//! The sums of a site from a Ballista cluster: the questions of `queries`, asked through DataFusion.
//!
//! Owns the session and what becomes of the rows that come back. The crate's door to both.

use super::queries::{self, Scope, TABLE};
use super::summary::{CellGroup, LANES, Summary, Windows};
use super::sums::{Errors, Mean};
use crate::failure::Failure;
use crate::store;
use arrow_array::cast::AsArray;
use arrow_array::types::{ArrowPrimitiveType, Float32Type, Float64Type, Int32Type, Int64Type};
use arrow_array::{Array, PrimitiveArray, RecordBatch};
use arrow_schema::DataType;
use ballista::prelude::SessionContextExt;
use datafusion::error::DataFusionError;
use datafusion::execution::SessionStateBuilder;
use datafusion::execution::runtime_env::RuntimeEnvBuilder;
use datafusion::prelude::{ParquetReadOptions, SessionConfig, SessionContext};
use std::collections::BTreeMap;
use std::path::Path;
use tokio::runtime::Runtime;
use url::Url;

/// Parts of a query: a site's days are shared out between that many tasks.
const PARTITIONS: usize = 8;
/// Memory of all queries together here; beyond it they go to the disk.
const MEMORY_BYTES: usize = 512 << 20;

/// A cluster that reads the archive under the same path as this program.
pub(super) struct Cluster {
    runtime: Runtime,
    context: SessionContext,
    address: String,
}

impl Cluster {
    /// `address` is the scheduler's HOST:PORT; `threads` ask at a time.
    ///
    /// # Errors
    /// [`Failure`]: an archive that is not there, a cluster of which nothing can be known.
    pub(super) fn open(archive: &Path, address: &str, threads: usize) -> Result<Self, Failure> {
        let folder = archive
            .canonicalize()
            .map_err(|source| verge_desk::Failure::reading(archive, source))?;
        let runtime = tokio::runtime::Builder::new_multi_thread()
            .worker_threads(threads)
            .enable_all()
            .build()
            .map_err(|error| Failure::usage(format!("--threads {threads}: {error}")))?;
        let context = runtime.block_on(context(&folder, address))?;
        Ok(Self { runtime, context, address: address.to_owned() })
    }

    /// Asks for a site's sums.
    ///
    /// # Errors
    /// [`Failure::Cluster`].
    pub(super) fn site(&self, mut scope: Scope) -> Result<Summary, Failure> {
        let mut summary = of_lanes(&scope.site, &self.ask(&queries::lanes(&scope))?);
        if !summary.is_empty() {
            scope.window_s = summary.window_s;
            let batches = self.ask(&queries::cells(&scope))?;
            let archived =
                |batch| column::<Int64Type>(batch, "archived").values().iter().sum::<i64>();
            summary.rows += batches.iter().map(archived).sum::<i64>() as u64;
            summary.add_cells(&batches.iter().flat_map(cells).collect::<Vec<_>>());
        }
        Ok(summary)
    }

    fn ask(&self, sql: &str) -> Result<Vec<RecordBatch>, Failure> {
        let rows = async { self.context.sql(sql).await?.collect().await };
        self.runtime.block_on(rows).map_err(|error| failed(&self.address, &error))
    }
}

/// A session of the cluster that knows the archive as a table.
async fn context(folder: &Path, address: &str) -> Result<SessionContext, Failure> {
    let config = SessionConfig::new()
        .with_target_partitions(PARTITIONS)
        // The columns' ranges are of no use to these queries, and reading them at the start opens
        // every file once more.
        .with_collect_statistics(false);
    let runtime = RuntimeEnvBuilder::new()
        .with_memory_limit(MEMORY_BYTES, 1.0)
        // With a cache of the list of files, each query lists the whole archive when that list is
        // too long for it; without one, its own site's folder.
        .with_object_list_cache_limit(0)
        .build_arc()
        .map_err(|error| failed(address, &error))?;
    let state = SessionStateBuilder::new()
        .with_config(config)
        .with_runtime_env(runtime)
        .with_default_features()
        .build();
    let context = SessionContext::remote_with_state(&format!("df://{address}"), state)
        .await
        .map_err(|error| Failure::usage(format!("--cluster {address:?}: {error}")))?;
    let partition = |name: &str| (name.to_owned(), DataType::Utf8);
    let schema = store::arrow_schema();
    let options = ParquetReadOptions {
        schema: Some(&schema),
        table_partition_cols: vec![partition("site"), partition("date")],
        ..ParquetReadOptions::default()
    };
    // As a URL, for in a path `*`, `?` and `[` would make a pattern.
    let url = Url::from_directory_path(folder).expect("a canonical path is absolute");
    let registered = context.register_parquet(TABLE, url, options).await;
    registered.map_err(|error| failed(address, &error))?;
    Ok(context)
}

fn failed(address: &str, error: &DataFusionError) -> Failure {
    Failure::Cluster { address: address.to_owned(), reason: error.strip_backtrace() }
}

/// From the rows of [`queries::lanes`]: of the shortest windows in them.
fn of_lanes(site: &str, batches: &[RecordBatch]) -> Summary {
    let windows = |batch| column::<Int32Type>(batch, "window_s");
    let window_s = batches.iter().flat_map(|batch| windows(batch).values()).min().copied();
    let mut summary = Summary::new(site, window_s);
    let mut days = BTreeMap::<i64, [Windows; LANES]>::new();
    for batch in batches {
        let (windows, lanes) = (windows(batch), column::<Int32Type>(batch, "lane"));
        let integers = |name| column::<Int64Type>(batch, name);
        let (weekdays, bins, dates) = (integers("weekday"), integers("bin"), integers("day"));
        let (archived, sums) = (integers("archived"), Sums::of(batch));
        for row in (0..batch.num_rows()).filter(|row| Some(windows.value(*row)) == window_s) {
            let lane = (lanes.value(row) - 1) as usize;
            if dates.is_null(row) {
                let (weekday, bin) = (weekdays.value(row) as usize, bins.value(row) as usize);
                summary.add_time(weekday, bin, lane, sums.get(row));
            } else {
                summary.rows += archived.value(row) as u64;
                let known = sums.get(row).count as u32;
                days.entry(dates.value(row)).or_default()[lane] =
                    Windows { archived: archived.value(row) as u32, known };
            }
        }
    }
    summary.days = days.into_iter().collect();
    summary
}

/// From the rows of [`queries::cells`].
fn cells(batch: &RecordBatch) -> impl Iterator<Item = CellGroup> {
    let (lanes, sums) = (column::<Int32Type>(batch, "lane"), Sums::of(batch));
    let metres = |name| column::<Float32Type>(batch, name);
    let (positions, lengths) = (metres("position_m"), metres("length_m"));
    let integers = |name| column::<Int64Type>(batch, name);
    let (bins, since) = (integers("bin"), integers("first"));
    (0..batch.num_rows()).map(move |row| CellGroup {
        lane: (lanes.value(row) - 1) as usize,
        position_m: if positions.is_null(row) { f32::NAN } else { positions.value(row) },
        length_m: lengths.value(row),
        bin: bins.value(row) as usize,
        densities: sums.get(row),
        since_ms: since.value(row),
    })
}

/// Sums of densities and their counts, and of their errors where the query asks for them.
struct Sums<'a> {
    density: &'a PrimitiveArray<Float64Type>,
    known: &'a PrimitiveArray<Int64Type>,
    errors: Option<(&'a PrimitiveArray<Int64Type>, [&'a PrimitiveArray<Float64Type>; 3])>,
}

impl<'a> Sums<'a> {
    fn of(batch: &'a RecordBatch) -> Self {
        let errors = batch.column_by_name("stated").is_some().then(|| {
            let parts = ["variance", "calibration", "counting"].map(|name| column(batch, name));
            (column(batch, "stated"), parts)
        });
        Self { density: column(batch, "density"), known: column(batch, "known"), errors }
    }

    fn get(&self, row: usize) -> Mean {
        // A sum of nothing is null, and 0 below that.
        let sum = |of: &PrimitiveArray<Float64Type>| {
            if of.is_null(row) { 0.0 } else { of.value(row) }
        };
        let errors = self.errors.map_or_else(Errors::default, |(count, parts)| {
            let [variance, calibration, counting] = parts.map(sum);
            Errors { count: count.value(row) as u64, variance, calibration, counting }
        });
        Mean { sum: sum(self.density), count: self.known.value(row) as u64, errors }
    }
}

fn column<'a, T: ArrowPrimitiveType>(batch: &'a RecordBatch, name: &str) -> &'a PrimitiveArray<T> {
    batch.column_by_name(name).expect("the queries name it").as_primitive()
}
