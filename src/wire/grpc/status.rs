//! Problems as statuses: the one place where a code of HTTP becomes one of gRPC.

use std::collections::HashMap;
use std::time::Duration;

use serde_json::Value;
use tonic::{Code as GrpcCode, Status};
use tonic_types::{ErrorDetails, StatusExt};

use crate::wire::problem::{Code, Problem};
use crate::wire::proto;

/// Who defines the reasons.
const DOMAIN: &str = "union3d";

/// Most bytes of details in a status: they travel in a header, encoded in base64, and common clients take 8 KiB of headers.
const DETAILS_BYTES_MAX: usize = 4096;

/// Most bytes of a message in a status, for the same reason.
const MESSAGE_BYTES_MAX: usize = 1024;

/// Longest member in a status.
const MEMBER_BYTES_MAX: usize = 512;

const fn grpc_code(code: Code) -> GrpcCode {
    match code {
        Code::BadRequest
        | Code::BadJson
        | Code::BadProtobuf
        | Code::UnsupportedMediaType
        | Code::Invalid => GrpcCode::InvalidArgument,
        Code::Unauthenticated => GrpcCode::Unauthenticated,
        Code::Forbidden | Code::OriginNotAllowed | Code::HostNotAllowed => {
            GrpcCode::PermissionDenied
        }
        Code::NoSuchPath | Code::MethodNotAllowed => GrpcCode::Unimplemented,
        Code::NoSuchScene | Code::NoSuchCube => GrpcCode::NotFound,
        Code::SceneExists | Code::IdConflict | Code::ShapeExists => GrpcCode::AlreadyExists,
        Code::KeyReused | Code::OtherKind | Code::SceneNewer => GrpcCode::FailedPrecondition,
        Code::ReadTooSlowly => GrpcCode::Aborted,
        Code::SeqNotReached | Code::SeqNotKept | Code::NotReachable => GrpcCode::OutOfRange,
        Code::RequestTimeout | Code::WaitTimeout | Code::AnswerTimeout => {
            GrpcCode::DeadlineExceeded
        }
        Code::TooLarge
        | Code::SceneFull
        | Code::QueueFull
        | Code::MemoryUsed
        | Code::TooManyScenes => GrpcCode::ResourceExhausted,
        Code::Internal => GrpcCode::Internal,
        Code::AuditDifference | Code::SceneDamaged => GrpcCode::DataLoss,
        Code::Recovering
        | Code::SceneStopped
        | Code::ShuttingDown
        | Code::StorageFailed
        | Code::DiskFull => GrpcCode::Unavailable,
    }
}

/// A problem as the status that ends a call. `body` is the field whose content the places of the faults are in.
pub(super) fn status(problem: &Problem, body: &str) -> Status {
    let (code, problem) = message(problem, body);
    let mut details = ErrorDetails::new();
    let mut size = 0;
    let members = problem.members.into_iter();
    let members: HashMap<String, String> = members
        .filter(|(_, value)| value.len() <= MEMBER_BYTES_MAX)
        .inspect(|(name, value)| size += name.len() + value.len())
        .collect();
    details.set_error_info(problem.code, DOMAIN, members);
    for fault in problem.faults {
        size += fault.field.len() + fault.detail.len() + 16;
        if size > DETAILS_BYTES_MAX {
            break;
        }
        details.add_bad_request_violation(fault.field, fault.detail);
    }
    if let Some(seconds) = problem.retry_after_seconds {
        details.set_retry_info(Some(Duration::from_secs(seconds.into())));
    }
    let mut text = problem.detail;
    text.truncate(text.floor_char_boundary(MESSAGE_BYTES_MAX));
    Status::with_error_details(grpc_code(code), text, details)
}

/// A problem as a message, with its type.
pub(super) fn message(problem: &Problem, body: &str) -> (Code, proto::Problem) {
    let kind = problem.code().kind();
    let faults = problem.faults().iter().map(|fault| proto::Fault {
        field: match (&fault.pointer, &fault.parameter) {
            (Some(pointer), _) => field(body, pointer),
            (None, parameter) => {
                let parameter = parameter.as_deref().unwrap_or(body);
                parameter.to_ascii_lowercase().replace('-', "_")
            }
        },
        detail: match &fault.value {
            Some(value) => format!("{}: {value}", fault.detail),
            None => fault.detail.to_string(),
        },
    });
    let members = problem.members().iter().map(|(name, value)| {
        let text = match value {
            Value::String(text) => text.clone(),
            value => value.to_string(),
        };
        (name.clone(), text)
    });
    let message = proto::Problem {
        code: kind.code.to_owned(),
        detail: problem.detail().to_owned(),
        faults: faults.collect(),
        members: members.collect(),
        retry_after_seconds: kind.retry_after_seconds,
    };
    (problem.code(), message)
}

/// The path of a field: `/x/3` in the field `change` is `change.x[3]`.
fn field(body: &str, pointer: &str) -> String {
    let mut path = body.to_owned();
    for step in pointer.split('/').skip(1) {
        if step.bytes().all(|byte| byte.is_ascii_digit()) {
            path.extend(["[", step, "]"]);
        } else {
            path += if path.is_empty() { "" } else { "." };
            path += &step.replace("~1", "/").replace("~0", "~");
        }
    }
    path
}

/// What a status that a library made means, if that is one of ours.
pub(super) fn foreign(status: &Status) -> Option<Problem> {
    let code = match status.code() {
        // A message that is larger than the limit.
        GrpcCode::OutOfRange => Code::TooLarge,
        GrpcCode::Unimplemented => Code::NoSuchPath,
        GrpcCode::Internal | GrpcCode::InvalidArgument => Code::BadProtobuf,
        _ => return None,
    };
    Some(Problem::new(code, status.message()))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::wire::problem::{Fault, KINDS};

    #[test]
    fn places_are_paths_of_fields() {
        assert_eq!(field("change", "/insert_id/3"), "change.insert_id[3]");
        assert_eq!(field("settings", "/stock/min/0"), "settings.stock.min[0]");
        assert_eq!(field("settings", ""), "settings");
        assert_eq!(field("", "/a~1b"), "a/b");
    }

    #[test]
    fn a_status_fits_the_headers_of_any_client() {
        let mut problem = Problem::new(Code::Invalid, "x".repeat(100_000));
        for index in 0..100 {
            let fault = Fault::at(format!("/x/{index}"), "y".repeat(80), None);
            problem = problem.with_fault(fault);
        }
        let problem = problem.with("kept", "z".repeat(10_000)).with("seq", 5);
        let status = status(&problem, "change");
        assert!(status.details().len() < DETAILS_BYTES_MAX + 1024);
        assert!(status.message().len() <= MESSAGE_BYTES_MAX);
        let details = status.get_error_details();
        let info = details.error_info().unwrap();
        assert_eq!((&*info.reason, &*info.domain), ("invalid", DOMAIN));
        assert_eq!(info.metadata["seq"], "5");
        let violations = &details.bad_request().unwrap().field_violations;
        assert!(violations.len() > 10);
        assert_eq!(violations[3].field, "change.x[3]");
        assert_eq!(message(&problem, "change").1.faults.len(), 100);
    }

    #[test]
    fn what_may_be_tried_again_says_so() {
        for kind in KINDS
            .iter()
            .filter(|kind| kind.status == 503 || kind.status == 429)
        {
            let is_lasting = ["scene-damaged", "scene-newer"].contains(&kind.code);
            assert!(kind.retry_after_seconds.is_some() || is_lasting);
        }
        let status = status(&Problem::new(Code::QueueFull, "full"), "");
        let retry = status.get_error_details().retry_info().cloned().unwrap();
        assert_eq!(retry.retry_delay, Some(Duration::from_secs(1)));
    }
}
