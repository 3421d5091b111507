//! Where the queries run: DataFusion in this process, or a Ballista cluster.

use super::queries::TABLE;
use crate::failure::Failure;
use crate::store;
use datafusion::arrow::array::RecordBatch;
use datafusion::arrow::datatypes::DataType;
use datafusion::error::DataFusionError;
use datafusion::execution::SessionStateBuilder;
use datafusion::execution::runtime_env::RuntimeEnvBuilder;
use datafusion::prelude::{ParquetReadOptions, SessionConfig, SessionContext};
use std::path::{Path, PathBuf};
use url::Url;

/// What all queries together may hold; beyond it they go to the disk. A site takes some
/// megabytes.
const MEMORY_BYTES: usize = 512 << 20;

/// The archive as a table, and who answers queries about it.
pub(super) struct Engine {
    context: SessionContext,
    archive: PathBuf,
    cluster: Option<String>,
}

impl Engine {
    /// Each query is split `partitions` times. `cluster` is the scheduler's HOST:PORT; its
    /// executors read the archive under the same path.
    ///
    /// # Errors
    /// [`Failure`]: an archive that is not there, a cluster of which nothing can be known.
    pub(super) async fn open(
        archive: &Path,
        cluster: Option<&str>,
        partitions: usize,
    ) -> Result<Self, Failure> {
        let folder = archive
            .canonicalize()
            .map_err(|source| verge_desk::Failure::reading(archive, source))?;
        let config = SessionConfig::new()
            .with_target_partitions(partitions)
            // The columns' ranges are of no use to these queries, and reading them at the start
            // opens every file once more.
            .with_collect_statistics(false);
        let runtime = RuntimeEnvBuilder::new()
            .with_memory_limit(MEMORY_BYTES, 1.0)
            // With a cache of the list of files, each query lists the whole archive when that list
            // is too long for it; without one, its own site's folder.
            .with_object_list_cache_limit(0)
            .build_arc();
        let state = runtime.map(|runtime| {
            SessionStateBuilder::new()
                .with_config(config)
                .with_runtime_env(runtime)
                .with_default_features()
                .build()
        });
        let mut engine = Self {
            context: SessionContext::new(),
            archive: folder.clone(),
            cluster: cluster.map(str::to_owned),
        };
        let state = state.map_err(|error| engine.failed(&error))?;
        engine.context = match cluster {
            None => SessionContext::new_with_state(state),
            Some(address) => remote(address, state).await?,
        };
        let partition = |name: &str| (name.to_owned(), DataType::Utf8);
        let schema = store::arrow_schema();
        let options = ParquetReadOptions {
            schema: Some(&schema),
            table_partition_cols: vec![partition("site"), partition("date")],
            ..ParquetReadOptions::default()
        };
        // As a URL, for in a path `*`, `?` and `[` would make a pattern.
        let url = Url::from_directory_path(&folder).expect("a canonical path is absolute");
        let registered = engine.context.register_parquet(TABLE, url, options).await;
        registered.map_err(|error| engine.failed(&error))?;
        Ok(engine)
    }

    /// Runs a query.
    ///
    /// # Errors
    /// [`Failure::Cluster`], [`Failure::Query`].
    pub(super) async fn ask(&self, sql: &str) -> Result<Vec<RecordBatch>, Failure> {
        let rows = async { self.context.sql(sql).await?.collect().await };
        rows.await.map_err(|error| self.failed(&error))
    }

    fn failed(&self, error: &DataFusionError) -> Failure {
        let reason = error.strip_backtrace();
        match &self.cluster {
            Some(address) => Failure::Cluster { address: address.clone(), reason },
            None => Failure::Query { path: self.archive.clone(), reason },
        }
    }
}

#[cfg(feature = "ballista")]
async fn remote(
    address: &str,
    state: datafusion::execution::SessionState,
) -> Result<SessionContext, Failure> {
    use ballista::prelude::SessionContextExt;
    let context = SessionContext::remote_with_state(&format!("df://{address}"), state).await;
    context.map_err(|error| Failure::usage(format!("--cluster {address:?}: {error}")))
}

#[cfg(not(feature = "ballista"))]
async fn remote(
    address: &str,
    _: datafusion::execution::SessionState,
) -> Result<SessionContext, Failure> {
    let how = "this program was built without the feature ballista";
    Err(Failure::usage(format!("--cluster {address:?}: {how}")))
}
