//! The life of a scene: open its log, replay it, serve, and again after a failure.
//!
//! ```text
//!          ┌──────────────────────── probe_interval ◄──────────────┐
//!          ▼                                                       │
//!   open the log ──► replay ──► serve (`writer`) ──failure──► stopped ──► refused, when the files are found damaged twice
//! ```
//! The one way in, at start and after a failure.

use std::panic::{AssertUnwindSafe, catch_unwind};
use std::time::Instant;

use super::failpoint::{self, FailPoint};
use super::feed::Feed;
use super::inbox::Reply;
use super::kind::SceneKind;
use super::replay::{Compare, rebuild};
use super::scene::{Condition, SceneOf};
use super::writer::{Halt, Writer};
use super::{SceneState, Seq, ServiceConfig, ServiceError, meters};
use crate::log::{Keep, Log, LogError};

/// Runs a scene until its end. `writer` is there when the scene was just created.
pub(super) fn run<K: SceneKind>(scene: &SceneOf<K>, mut writer: Option<Writer<K>>) {
    // What the writer found damaged when it last stopped for that.
    let mut damaged = None;
    loop {
        let (halt, unanswered) = match writer.take().map_or_else(|| attempt(scene), Ok) {
            Ok(writer) => serve_until_halt(scene, writer, &mut damaged),
            Err(halt) => (halt, Vec::new()),
        };
        let Halt::Log(error) = halt else {
            return;
        };
        let comes_back = stop(scene, &error);
        // After the condition: who hears of the failure and looks again must not see the scene running.
        let refusal = unacknowledged(&error);
        for reply in unanswered {
            reply.send(Err(refusal.clone()));
        }
        let ended = || scene.inbox.wait_end(scene.setup.config.probe_interval);
        if !comes_back || ended().is_some() {
            return;
        }
    }
}

/// One try to bring the scene back. A read that fails is damage to SQLite, so damage is believed when a second look finds some too.
fn attempt<K: SceneKind>(scene: &SceneOf<K>) -> Result<Writer<K>, Halt> {
    let reopen = || {
        // A panic here is met again at every try (the log is the same), so the scene is refused rather than retried.
        catch_unwind(AssertUnwindSafe(|| reopen(scene))).unwrap_or_else(|_| {
            Err(Halt::Log(LogError::Foreign {
                path: scene.directory.clone(),
                detail:
                    "replay failed by a fault of this program; see its log, and try a newer version"
                        .to_owned(),
            }))
        })
    };
    let writer = match reopen() {
        Err(Halt::Log(LogError::Damaged { .. })) => reopen(),
        first => first,
    }?;
    writer.begin(scene);
    Ok(writer)
}

fn serve_until_halt<K: SceneKind>(
    scene: &SceneOf<K>,
    mut writer: Writer<K>,
    damaged: &mut Option<(Seq, String)>,
) -> (Halt, Vec<Reply<K>>) {
    let halt = catch_unwind(AssertUnwindSafe(|| writer.serve(scene))).unwrap_or_else(|_| {
        // Nothing unlogged was shown, so a fault of this program is survived like one of the disk.
        Halt::Log(LogError::Failed {
            path: scene.directory.clone(),
            cause: "the writer failed by a fault of this program; see its log".to_owned(),
        })
    });
    let halt = match halt {
        // A replay tells better, except of what it does not read: that is found here again.
        Halt::Log(LogError::Damaged { path, seq, detail })
            if damaged.as_ref() != Some(&(seq, detail.clone())) =>
        {
            let cause = format!("damaged at seq {}: {detail}", seq.0);
            *damaged = Some((seq, detail));
            Halt::Log(LogError::Failed { path, cause })
        }
        halt => halt,
    };
    (halt, writer.unanswered)
}

/// Stops the scene for its callers; says whether it can come back by itself.
fn stop<K: SceneKind>(scene: &SceneOf<K>, error: &LogError) -> bool {
    let name = scene.name().as_str();
    let cause = error.to_string();
    let refusal = match error {
        LogError::Damaged { .. } | LogError::Foreign { .. } => {
            tracing::error!(
                scene = name,
                cause,
                "refused until its files are mended or dropped"
            );
            scene.set_condition(Condition::Damaged {
                cause: cause.clone(),
            });
            ServiceError::Damaged { cause }
        }
        LogError::Newer { .. } => {
            tracing::error!(
                scene = name,
                cause,
                "left alone: a newer version of this program made it"
            );
            scene.set_condition(Condition::Newer {
                cause: cause.clone(),
            });
            ServiceError::Newer { cause }
        }
        LogError::Full { .. } | LogError::Failed { .. } => {
            // It is tried again every moment: only what is new is worth a line.
            if let SceneState::Stopped { cause: before, .. } = scene.state()
                && before == cause
            {
                tracing::debug!(scene = name, cause, "still stopped");
            } else {
                tracing::error!(
                    scene = name,
                    cause,
                    "stopped until the disk takes writes again"
                );
                meters::scene_stopped();
            }
            let full = matches!(error, LogError::Full { .. });
            scene.set_condition(Condition::Stopped {
                cause: cause.clone(),
                full,
            });
            ServiceError::Stopped { cause, full }
        }
    };
    scene.refuse_waiting(&refusal);
    scene.set_started();
    matches!(refusal, ServiceError::Stopped { .. })
}

/// Opens the scene's log, proves that it takes writes, and replays it.
pub(super) fn reopen<K: SceneKind>(scene: &SceneOf<K>) -> Result<Writer<K>, Halt> {
    let ended = || scene.inbox.ended().is_some();
    let _pass = scene.setup.gate.enter(ended).ok_or(Halt::Ended)?;
    failpoint::pass(scene.setup.fail_hook.as_ref(), FailPoint::Open)?;
    let (log, notices) = Log::<K>::open(&scene.directory, keep(&scene.setup.config))?;
    for notice in &notices {
        tracing::warn!(scene = scene.name().as_str(), "{notice}");
    }
    scene.keep_notices(notices);
    log.probe()?;
    scene.set_permille(0);
    scene.set_condition(Condition::Recovering);
    let start = Instant::now();
    let writer = revive(scene, log)?;
    let published = writer.published();
    meters::recovered(start.elapsed());
    tracing::info!(
        scene = scene.name().as_str(),
        seq = published.seq.0,
        bodies = K::count(&published.totals),
        milliseconds = start.elapsed().as_millis(),
        "recovered"
    );
    Ok(writer)
}

/// Limits of what the scene's log keeps.
pub(super) fn keep(config: &ServiceConfig) -> Keep {
    Keep {
        snapshot_log_bytes_min: config.snapshot_log_bytes_min,
        history_changes_max: config.history_changes_max,
        idempotency_keys_max: config.idempotency_keys_max,
        revert_changes_max: config.revert_changes_max,
        revert_bytes_max: config.revert_bytes_max,
        write_ahead_pages_max: config.write_ahead_pages_max,
    }
}

/// Replays an open log.
pub(super) fn revive<K: SceneKind>(scene: &SceneOf<K>, mut log: Log<K>) -> Result<Writer<K>, Halt> {
    if !scene.keep_header(log.header()) {
        let detail = "another scene's files were put here while it was stopped".to_owned();
        let path = scene.directory.clone();
        return Err(LogError::Foreign { path, detail }.into());
    }
    let rebuilt = rebuild(
        &mut log,
        &scene.directory,
        Compare::Some,
        |permille| scene.set_permille(permille),
        || scene.inbox.ended().is_some(),
    )?;
    let rebuilt = rebuilt.ok_or(Halt::Ended)?;
    let history = log.history()?;
    let mut published = rebuilt.published();
    if published.seq == Seq(0) {
        published.at_ms = log.created_ms();
    }
    let feed = Feed::new(rebuilt.engine, &published, history, log.context());
    Ok(Writer::new(log, &published, rebuilt.next_id, feed))
}

/// What a change is answered when the commit it was in has failed.
fn unacknowledged(error: &LogError) -> ServiceError {
    ServiceError::Stopped {
        cause: format!(
            "{error}; this change was not acknowledged: when the scene is back it is there whole or not at all"
        ),
        full: matches!(error, LogError::Full { .. }),
    }
}
