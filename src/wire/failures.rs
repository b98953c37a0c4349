//! What calls that failed leave in the log: what the server did wrong as an error, what it could not do as a warning, and nothing of
//! what a client did wrong. A flood of them is a line a second that says how many there were.

use std::sync::Arc;
use std::time::{Duration, Instant};

use axum::http::StatusCode;
use parking_lot::Mutex;
use tower_http::classify::{
    GrpcCode, GrpcErrorsAsFailures, GrpcFailureClass, ServerErrorsFailureClass, SharedClassifier,
};
use tracing::Span;

/// Lines of one kind are at least so far apart.
const PAUSE: Duration = Duration::from_secs(1);

/// Lets a line of a kind through now and then, and counts the others.
#[derive(Default)]
pub(super) struct Seldom(Mutex<Past>);

#[derive(Default)]
struct Past {
    last: Option<Instant>,
    untold: u64,
}

impl Seldom {
    /// How many were not told since the last line, when one is due.
    pub(super) fn due(&self) -> Option<u64> {
        self.due_at(Instant::now())
    }

    fn due_at(&self, now: Instant) -> Option<u64> {
        let mut past = self.0.lock();
        if past
            .last
            .is_some_and(|last| now.duration_since(last) < PAUSE)
        {
            past.untold += 1;
            return None;
        }
        past.last = Some(now);
        Some(std::mem::take(&mut past.untold))
    }
}

/// How bad it is that a call failed.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
enum Level {
    /// The server did something wrong.
    Error,
    /// It could not do it now.
    Warning,
}

/// Which statuses of gRPC are failures of the server.
pub(super) fn of_grpc() -> SharedClassifier<GrpcErrorsAsFailures> {
    let of_clients = [
        GrpcCode::Cancelled,
        GrpcCode::InvalidArgument,
        GrpcCode::DeadlineExceeded,
        GrpcCode::NotFound,
        GrpcCode::AlreadyExists,
        GrpcCode::PermissionDenied,
        GrpcCode::ResourceExhausted,
        GrpcCode::FailedPrecondition,
        GrpcCode::Aborted,
        GrpcCode::OutOfRange,
        GrpcCode::Unimplemented,
        GrpcCode::Unauthenticated,
    ];
    let mut classifier = GrpcErrorsAsFailures::new();
    for code in of_clients {
        classifier = classifier.with_success(code);
    }
    SharedClassifier::new(classifier)
}

/// What tells of failures over HTTP.
pub(super) fn tell_http() -> impl FnMut(ServerErrorsFailureClass, Duration, &Span) + Clone {
    let level = |failure: &ServerErrorsFailureClass| match failure {
        ServerErrorsFailureClass::StatusCode(StatusCode::INTERNAL_SERVER_ERROR) => Level::Error,
        _ => Level::Warning,
    };
    tell(level, ToString::to_string)
}

/// The same over gRPC.
pub(super) fn tell_grpc() -> impl FnMut(GrpcFailureClass, Duration, &Span) + Clone {
    let level = |failure: &GrpcFailureClass| match failure {
        GrpcFailureClass::Status(status) if status.code() != Some(GrpcCode::Unavailable) => {
            Level::Error
        }
        _ => Level::Warning,
    };
    tell(level, ToString::to_string)
}

fn tell<F>(
    level: impl Fn(&F) -> Level + Clone,
    text: impl Fn(&F) -> String + Clone,
) -> impl FnMut(F, Duration, &Span) + Clone {
    let (errors, warnings) = (Arc::new(Seldom::default()), Arc::new(Seldom::default()));
    move |failure, waited, span| {
        let level = level(&failure);
        let seldom = match level {
            Level::Error => &errors,
            Level::Warning => &warnings,
        };
        let Some(untold) = seldom.due() else {
            return;
        };
        let (failure, ms) = (text(&failure), u64::try_from(waited.as_millis()).ok());
        match level {
            Level::Error => tracing::error!(parent: span, failure, ms, untold, "a call failed"),
            Level::Warning => {
                tracing::warn!(parent: span, failure, ms, untold, "a call was not answered");
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_flood_is_a_line_a_second_that_counts_it() {
        let (seldom, start) = (Seldom::default(), Instant::now());
        let told: Vec<_> = (0..3_000)
            .filter_map(|ms| Some((ms, seldom.due_at(start + Duration::from_millis(ms))?)))
            .collect();
        assert_eq!(told, [(0, 0), (1_000, 999), (2_000, 999)]);
    }
}
