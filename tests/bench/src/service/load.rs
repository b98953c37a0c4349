//! Clients that send what was made beforehand, as fast as they are answered.

use std::cell::RefCell;
use std::future::Future;
use std::net::SocketAddr;
use std::rc::Rc;
use std::time::{Duration, Instant};

use bytes::Bytes;
use hyper::{Method, StatusCode};
use tokio::task::LocalSet;

use super::link::Link;
use crate::failure::Failure;
use crate::figures::{Latencies, Spread, median, rate};

/// What the clients got done.
#[derive(Debug, Default)]
pub(super) struct Done {
    /// Requests answered with success.
    pub(super) requests: usize,
    /// From the first request until the last answer.
    pub(super) time: Duration,
    pub(super) latencies: Latencies,
}

/// Requests that clients take from, each once.
pub(super) struct Supply {
    path: String,
    content_type: Option<&'static str>,
    method: Method,
    bodies: Vec<Bytes>,
    next: usize,
    /// Begin again after the last one.
    endless: bool,
}

impl Supply {
    /// Bodies to be posted, each once.
    pub(super) fn posts(path: String, content_type: &'static str, bodies: Vec<Bytes>) -> Self {
        Self {
            path,
            content_type: Some(content_type),
            method: Method::POST,
            bodies,
            next: 0,
            endless: false,
        }
    }

    /// One question again and again.
    pub(super) fn gets(path: String) -> Self {
        Self {
            path,
            content_type: None,
            method: Method::GET,
            bodies: vec![Bytes::new()],
            next: 0,
            endless: true,
        }
    }

    fn take(&mut self) -> Option<Bytes> {
        if self.endless {
            return self.bodies.first().cloned();
        }
        let body = self.bodies.get(self.next).cloned();
        self.next += 1;
        body
    }
}

/// Has `clients` send from the supply, each its next request when it has the answer to its last, until time is over or nothing is
/// left to send. What is under way then is waited for, and counts.
pub(super) async fn run(
    server: SocketAddr,
    clients: usize,
    supply: Supply,
    time: Duration,
) -> Result<Done, Failure> {
    let mut links = Vec::new();
    for _ in 0..clients {
        links.push(Link::open(server).await?);
    }
    let (method, path) = (supply.method.clone(), supply.path.clone());
    let content_type = supply.content_type;
    let supply = Rc::new(RefCell::new(supply));
    let started = Instant::now();
    let tasks_here = LocalSet::new();
    let tasks: Vec<_> = links
        .into_iter()
        .map(|mut link| {
            let (supply, method, path) = (Rc::clone(&supply), method.clone(), path.clone());
            tasks_here.spawn_local(async move {
                let mut latencies = Latencies::default();
                while started.elapsed() < time {
                    let Some(body) = supply.borrow_mut().take() else {
                        break;
                    };
                    let sent = Instant::now();
                    // A full queue is no failure: it says when to come again.
                    loop {
                        let request = link.send(method.clone(), &path, content_type, body.clone());
                        let (status, text) = request.await.map_err(|error| error.to_string())?;
                        if status.is_success() {
                            break;
                        }
                        if status != StatusCode::TOO_MANY_REQUESTS {
                            let text = String::from_utf8_lossy(&text);
                            return Err(format!("{path} answers {status}: {text}"));
                        }
                        tokio::time::sleep(Duration::from_millis(10)).await;
                    }
                    latencies.push(sent.elapsed());
                }
                Ok(latencies)
            })
        })
        .collect();
    tasks_here.await;
    let mut done = Done {
        time: started.elapsed(),
        ..Done::default()
    };
    for task in tasks {
        let latencies = task.await??;
        done.requests += latencies.len();
        done.latencies.extend(&latencies);
    }
    Ok(done)
}

/// Runs something on this thread alone.
pub(super) fn on_this_thread<T>(
    work: impl Future<Output = Result<T, Failure>>,
) -> Result<T, Failure> {
    let mut runtime = tokio::runtime::Builder::new_current_thread();
    runtime.enable_all().build()?.block_on(work)
}

/// Medians over runs.
pub(super) struct Summary {
    /// Requests answered in a second.
    pub(super) requests: f64,
    // How long they took. Units: milliseconds.
    pub(super) p50: f64,
    pub(super) p99: f64,
    pub(super) p999: f64,
    pub(super) max: f64,
}

impl Summary {
    pub(super) fn of(runs: Vec<Done>) -> Self {
        let rates = runs.iter().map(|done| rate(done.requests, done.time));
        let requests = median(rates);
        let spreads = runs.into_iter().map(|done| done.latencies.spread());
        let spread = Spread::median_of(&spreads.collect::<Vec<_>>());
        Self {
            requests,
            p50: spread.p50 / 1e3,
            p99: spread.p99 / 1e3,
            p999: spread.p999 / 1e3,
            max: spread.max / 1e3,
        }
    }
}
