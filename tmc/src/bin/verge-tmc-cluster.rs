//! `verge-tmc-cluster`: a Ballista scheduler or executor for `verge-tmc report --cluster`, of
//! the version of Ballista that `verge-tmc` was built with.
//!
//! Both run until SIGTERM or SIGINT. With `--with-parent` they also end when their standard
//! input does, so that none stays behind a parent that was killed.

use ballista_core::config::TaskSchedulingPolicy;
use ballista_executor::executor_process::{ExecutorProcessConfig, start_executor_process};
use ballista_scheduler::cluster::BallistaCluster;
use ballista_scheduler::config::SchedulerConfig;
use ballista_scheduler::scheduler_process::{create_scheduler, start_grpc_service_with_listener};
use clap::{Parser, Subcommand};
use datafusion_proto::protobuf::{LogicalPlanNode, PhysicalPlanNode};
use std::error::Error;
use std::io::Read;
use std::net::{IpAddr, SocketAddr};
use std::path::PathBuf;
use std::process::ExitCode;
use std::sync::Arc;
use tokio::net::TcpListener;

/// Stack of a thread: plans are walked by recursion.
const STACK_BYTES: usize = 32 << 20;
/// How long an executor waits for its scheduler, s.
const CONNECT_S: u16 = 60;

/// One process of a cluster that answers `verge-tmc report --cluster`.
#[derive(Parser)]
#[command(version)]
struct Arguments {
    #[command(subcommand)]
    part: Part,
    /// End when standard input ends.
    #[arg(long, global = true)]
    with_parent: bool,
}

#[derive(Subcommand)]
enum Part {
    /// Takes queries and shares them out; prints where it listens.
    Scheduler {
        /// Where to listen; port 0 is any.
        #[arg(long, value_name = "IP:PORT", default_value = "127.0.0.1:50050")]
        bind: SocketAddr,
    },
    /// Runs parts of queries.
    Executor {
        /// The scheduler.
        #[arg(long, value_name = "HOST:PORT")]
        scheduler: String,
        /// Where others fetch its results from: an address that they can reach.
        #[arg(long, value_name = "IP:PORT", default_value = "127.0.0.1:50051")]
        bind: SocketAddr,
        /// Folder for what it hands on; must be its own.
        #[arg(long, value_name = "DIR")]
        work: PathBuf,
        /// Parts that it runs at the same time; without it as many as there are processors.
        #[arg(long, value_name = "N", default_value_t = 0)]
        cores: usize,
    },
}

fn main() -> ExitCode {
    let arguments = Arguments::parse();
    if arguments.with_parent {
        std::thread::spawn(|| {
            // Whatever comes is of no interest; an error is an end as well.
            let _ = std::io::stdin().read_to_end(&mut Vec::new());
            std::process::exit(0);
        });
    }
    let runtime = tokio::runtime::Builder::new_multi_thread()
        .enable_all()
        .thread_stack_size(STACK_BYTES)
        .build();
    let result = match (runtime, arguments.part) {
        (Err(error), _) => Err(error.into()),
        (Ok(runtime), Part::Scheduler { bind }) => runtime.block_on(scheduler(bind)),
        (Ok(runtime), Part::Executor { scheduler, bind, work, cores }) => {
            runtime.block_on(executor(&scheduler, bind, work, cores))
        }
    };
    match result {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("verge-tmc-cluster: {error}");
            ExitCode::from(verge_desk::sysexits::UNAVAILABLE)
        }
    }
}

async fn scheduler(bind: SocketAddr) -> Result<(), Box<dyn Error>> {
    let listener = TcpListener::bind(bind).await?;
    let address = listener.local_addr()?;
    let config = SchedulerConfig {
        bind_host: address.ip().to_string(),
        bind_port: address.port(),
        external_host: address.ip().to_string(),
        // Executors ask for work: they need one port each, and may sit behind a firewall.
        scheduling_policy: TaskSchedulingPolicy::PullStaged,
        ..SchedulerConfig::default()
    };
    let cluster = BallistaCluster::new_from_config(&config).await?;
    let server =
        create_scheduler::<LogicalPlanNode, PhysicalPlanNode>(cluster, Arc::new(config)).await?;
    verge_desk::print(&format!("{address}\n"))?;
    tokio::select! {
        done = start_grpc_service_with_listener(listener, server) => Ok(done?),
        () = stopped() => Ok(()),
    }
}

async fn executor(
    scheduler: &str,
    bind: SocketAddr,
    work: PathBuf,
    cores: usize,
) -> Result<(), Box<dyn Error>> {
    let (host, port) = scheduler.rsplit_once(':').ok_or("--scheduler: give HOST:PORT")?;
    std::fs::create_dir_all(&work)?;
    let host_of = |ip: IpAddr| ip.to_string();
    let config = ExecutorProcessConfig {
        bind_host: host_of(bind.ip()),
        external_host: Some(host_of(bind.ip())),
        port: bind.port(),
        scheduler_host: host.to_owned(),
        scheduler_port: port.parse()?,
        scheduler_connect_timeout_seconds: CONNECT_S,
        vcores: cores,
        task_scheduling_policy: TaskSchedulingPolicy::PullStaged,
        work_dir: Some(work.to_string_lossy().into_owned()),
        // Data fetched for a report are of no use an hour later.
        job_data_ttl_seconds: 3600,
        job_data_clean_up_interval_seconds: 600,
        ..ExecutorProcessConfig::default()
    };
    // It waits for SIGTERM and SIGINT itself.
    Ok(start_executor_process(Arc::new(config)).await?)
}

/// SIGTERM or SIGINT.
async fn stopped() {
    use tokio::signal::unix::{SignalKind, signal};
    let (terminate, interrupt) = (signal(SignalKind::terminate()), signal(SignalKind::interrupt()));
    if let (Ok(mut terminate), Ok(mut interrupt)) = (terminate, interrupt) {
        tokio::select! { _ = terminate.recv() => (), _ = interrupt.recv() => () }
    }
}
