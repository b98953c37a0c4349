//! Everything that can go wrong, as RFC 9457 problem documents with stable types.
//!
//! A type is a relative URI, `/problems/CODE`, that the server itself explains. Clients may rely on the code and the status;
//! title and detail are for people.

use std::borrow::Cow;

use axum::http::{HeaderValue, StatusCode, Uri, header};
use axum::response::{IntoResponse, Response};
use problem_details::ProblemDetails;
use serde::Serialize;
use serde_json::{Map, Value, value::RawValue};
use utoipa::ToSchema;

use super::documents::IdForm;
use crate::engine::{Rejected, solids};
use crate::service::ServiceError;

/// Most faults that one answer names.
pub const FAULTS_MAX: usize = 100;

/// Longest piece of a client's text that an answer repeats, in bytes.
const ECHO_BYTES_MAX: usize = 80;

/// Longest place of a fault, which may be a name that the client made up, in bytes.
const PLACE_BYTES_MAX: usize = 512;

/// Longest detail, which may repeat a place or a name, in bytes.
const DETAIL_BYTES_MAX: usize = 2_048;

/// What a type of problem means.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Serialize, ToSchema)]
pub struct Kind {
    /// The last part of the type's URI.
    #[schema(example = "id-conflict")]
    pub code: &'static str,
    /// HTTP status.
    #[schema(example = 409)]
    pub status: u16,
    /// Short summary, the same for every occurrence.
    pub title: &'static str,
    /// What it means and what to do.
    pub meaning: &'static str,
    /// Seconds after which a retry may succeed, where that is known.
    pub retry_after_seconds: Option<u32>,
}

macro_rules! kinds {
    ($($name:ident $code:literal $status:literal $retry:expr, $title:literal, $meaning:literal;)*) => {
        /// The types of problems.
        #[derive(Clone, Copy, PartialEq, Eq, Debug)]
        pub enum Code {
            $(#[doc = $title] $name,)*
        }

        /// What the types mean, in the order of [`Code`].
        pub const KINDS: &[Kind] = &[$(Kind {
            code: $code,
            status: $status,
            title: $title,
            meaning: $meaning,
            retry_after_seconds: $retry,
        },)*];
    };
}

kinds! {
    BadRequest "bad-request" 400 None, "The request cannot be read",
        "The path is not UTF-8, or the connection broke while the body arrived.";
    BadJson "bad-json" 400 None, "The body is not JSON",
        "`line` and `column` say where reading stopped; for a stream `line` is the line of the stream. Nothing of the change was applied.";
    BadProtobuf "bad-protobuf" 400 None, "The body is not a protobuf message",
        "The body must be one message union3d.v1.Change, or of a batch union3d.v1.ChangeBatch.";
    Unauthenticated "unauthenticated" 401 None, "A key is needed",
        "This server has keys, and none that it knows was sent. Send Authorization: Bearer KEY.";
    Forbidden "forbidden" 403 None, "The key has not this right",
        "The rights of a key are read, write and admin, on scenes by their names. The file of keys says them.";
    OriginNotAllowed "origin-not-allowed" 403 None, "Pages of this origin may not ask",
        "A browser sent this for a page that is not of this server. Who runs the server can allow the page's origin: --allow-origin.";
    NoSuchPath "no-such-path" 404 None, "There is nothing at this path",
        "/openapi.json and /docs describe every path.";
    NoSuchScene "no-such-scene" 404 None, "There is no such scene",
        "Create it with PUT /v1/scenes/{scene}.";
    NoSuchCube "no-such-cube" 404 None, "There is no such cube or solid",
        "No cube or solid of the scene has this id now.";
    SeqNotReached "seq-not-reached" 404 None, "The scene has not come to this seq",
        "`newest` is the newest. ?wait=SEQ waits for one to come.";
    MethodNotAllowed "method-not-allowed" 405 None, "The path does not take this method",
        "The Allow header lists the methods that it takes.";
    RequestTimeout "request-timeout" 408 None, "The request took too long to arrive",
        "The body paused or lasted longer than the server waits. Of an atomic change nothing was applied; of a stream the first `committed_lines`.";
    WaitTimeout "wait-timeout" 408 None, "The seq did not come in time",
        "The wait is bounded; ask again to wait on.";
    SceneExists "scene-exists" 409 None, "The scene exists with other settings",
        "`settings` are those it has. Settings are fixed for a scene's life: delete it first, or use another name.";
    IdConflict "id-conflict" 409 None, "An id is at another place already",
        "A cube is moved, and a solid changed, by deleting and inserting its id in one change. Nothing of the change was applied; of a stream the first `committed_lines`.";
    OtherKind "other-kind" 409 None, "The scene is of another kind",
        "A scene is of cubes or of solids, for its life. This call is for the other kind; the detail names the scene's.";
    ShapeExists "shape-exists" 409 None, "The shape cannot be defined",
        "There is another shape of this name, and a shape never changes; or the scene has as many shapes as it may, 1,024. Take another name, or a shape that is there.";
    ReadTooSlowly "read-too-slowly" 409 None, "The listing was read too slowly",
        "So much has changed since the listing began that it cannot be finished as of one seq, and it broke off. List again and read faster, or read a page at a time.";
    SeqNotKept "seq-not-kept" 410 None, "This seq is no longer kept",
        "`oldest` is the oldest whose totals are kept.";
    NotReachable "seq-not-reachable" 410 None, "This seq can no longer be gone back to",
        "`oldest` is the oldest that can: the operations of older changes were dropped behind a snapshot. The settings revert_changes_max and revert_bytes_max say how many are kept.";
    TooLarge "too-large" 413 None, "The request is larger than the limits",
        "Split the change, or send application/x-ndjson, which has no limit as a whole; go back by way of a seq in between.";
    UnsupportedMediaType "unsupported-media-type" 415 None, "The body's type is not taken here",
        "The detail lists the types that are. Content-Encoding is not taken.";
    HostNotAllowed "host-not-allowed" 421 None, "The server does not go by this name",
        "The name in Host, or :authority, is none of this server's: its addresses, those of loopback, and the names of --allowed-host. So a page cannot point a name of its own at this server.";
    Invalid "invalid" 422 None, "The request can be read but is wrong",
        "`errors` names the first hundred faults, each with its place and value. Nothing of the change was applied; of a stream the first `committed_lines`.";
    SceneFull "scene-full" 422 None, "The scene would hold too many cubes or solids",
        "A scene holds at most 2^31 cubes, or 2^24 solids.";
    KeyReused "idempotency-key-reused" 422 None, "The idempotency key came before with another body",
        "A key stands for one body. Use a new key for a new change.";
    QueueFull "queue-full" 429 Some(1), "Too many changes are waiting",
        "So many changes wait for the scene that this one was not taken. Nothing of it was applied. Send it again after the time in Retry-After.";
    MemoryUsed "memory-used" 429 Some(1), "The memory for requests is used up",
        "Requests share a part of the server's memory (memory_bytes_max), and a client's share of it is as much as is free. Nothing was applied. Send it again after the time in Retry-After, or smaller.";
    TooManyScenes "too-many-scenes" 507 None, "There are as many scenes as may be",
        "The setting scenes_max says how many. Drop one that is not needed.";
    Internal "internal" 500 None, "The server failed",
        "A fault of the server, which its log describes. Whether a change was applied is shown by its seq; sending it again is safe when it names its ids or has an Idempotency-Key.";
    AuditDifference "audit-difference" 500 None, "The totals differ from a recount",
        "`kept` are the totals the scene answers with, `recounted` those of its cubes. They must never differ: keep the data directory and report it.";
    Recovering "recovering" 503 Some(1), "The scene is being replayed",
        "It answers when `percent` has come to 100.";
    SceneStopped "scene-stopped" 503 Some(5), "The scene is stopped after a failed write",
        "`cause` says why. It comes back by itself when the disk takes writes again. Whether the last change was applied is shown by the seq then.";
    SceneDamaged "scene-damaged" 503 None, "The scene's files are damaged",
        "`cause` says what is damaged and what to do. It does not come back by itself, and never with wrong totals.";
    SceneNewer "scene-newer" 503 None, "A newer version of this program made the scene's files",
        "They are left as they are: nothing is damaged. `cause` names their format; a server of that version reads them.";
    ShuttingDown "shutting-down" 503 Some(5), "The server is shutting down",
        "Nothing of the change was applied; of a stream the first `committed_lines`.";
    AnswerTimeout "answer-timeout" 503 Some(5), "The answer took too long",
        "A change may still be applied. Sending it again is safe when it names its ids or has an Idempotency-Key.";
    StorageFailed "storage-failed" 503 Some(5), "The data directory does not take the scene's files",
        "`cause` says why.";
    DiskFull "disk-full" 507 Some(5), "The disk is full",
        "The scene comes back by itself when there is space again; its seq shows then whether the change was kept. Sending it again is safe when it names its ids or has an Idempotency-Key.";
}

impl Code {
    /// What this type means.
    pub fn kind(self) -> &'static Kind {
        &KINDS[self as usize]
    }

    /// HTTP status.
    pub fn status(self) -> StatusCode {
        StatusCode::from_u16(self.kind().status).expect("the table has statuses of three digits")
    }
}

/// One thing that is wrong in a request.
#[derive(Clone, PartialEq, Debug, Serialize, ToSchema)]
pub struct Fault {
    /// Where in the body: an RFC 6901 JSON pointer.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schema(example = "/insert/3/at/1")]
    #[schema(nullable = false)]
    pub pointer: Option<String>,
    /// Where else: the name of a path or query parameter, or of a header.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schema(nullable = false)]
    pub parameter: Option<Cow<'static, str>>,
    /// What is wrong with it.
    #[schema(example = "is not a number")]
    pub detail: Cow<'static, str>,
    /// What was sent there; as text where it is no JSON number or very long.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schema(value_type = Value)]
    pub value: Option<Value>,
}

impl Fault {
    /// A fault in the body, at an RFC 6901 JSON pointer.
    pub fn at(
        pointer: String,
        detail: impl Into<Cow<'static, str>>,
        value: Option<&RawValue>,
    ) -> Self {
        Self {
            pointer: Some(pointer),
            parameter: None,
            detail: detail.into(),
            value: value.map(|raw| echo(raw.get())),
        }
    }

    /// Shows what was sent at its place.
    pub fn show(&mut self, value: &RawValue) {
        self.value = Some(echo(value.get()));
    }

    /// A fault in a parameter or header.
    pub fn in_parameter(
        parameter: impl Into<Cow<'static, str>>,
        detail: impl Into<Cow<'static, str>>,
        value: &str,
    ) -> Self {
        Self {
            pointer: None,
            parameter: Some(parameter.into()),
            detail: detail.into(),
            value: Some(Value::String(shortened(value))),
        }
    }

    /// As it may be answered, however long the names are that were sent.
    fn bounded(mut self) -> Self {
        self.pointer = self.pointer.map(|place| cut(place, PLACE_BYTES_MAX));
        let name = |name: Cow<'static, str>| match name {
            Cow::Owned(name) => Cow::Owned(cut(name, PLACE_BYTES_MAX)),
            known @ Cow::Borrowed(_) => known,
        };
        self.parameter = self.parameter.map(name);
        self.detail = name(self.detail);
        self
    }
}

/// A client's JSON as it may be repeated: scalars as they are, as text what is long or what a number cannot hold.
fn echo(raw: &str) -> Value {
    let scalar = raw.len() <= ECHO_BYTES_MAX && !raw.starts_with(['{', '[']);
    match serde_json::from_str(raw) {
        Ok(Value::Number(number)) if number.is_f64() && !raw.contains(['.', 'e', 'E']) => {
            Value::String(shortened(raw))
        }
        Ok(value) if scalar => value,
        _ => Value::String(shortened(raw)),
    }
}

fn shortened(text: &str) -> String {
    cut(text.to_owned(), ECHO_BYTES_MAX)
}

/// A text of at most so many bytes, with dots where more is cut off.
fn cut(mut text: String, bytes_max: usize) -> String {
    if text.len() > bytes_max {
        text.truncate(text.floor_char_boundary(bytes_max));
        text += "...";
    }
    text
}

/// The first hundred faults of a request.
#[derive(Debug, Default)]
pub struct Faults(Vec<Fault>);

impl Faults {
    /// Notes one; beyond the hundredth they are dropped.
    pub fn push(&mut self, fault: Fault) {
        if !self.is_full() {
            self.0.push(fault);
        }
    }

    /// Whether there are a hundred: looking for more is of no use.
    pub fn is_full(&self) -> bool {
        self.0.len() >= FAULTS_MAX
    }

    /// Whether there is none.
    pub fn is_empty(&self) -> bool {
        self.0.is_empty()
    }

    /// How many there are.
    pub fn len(&self) -> usize {
        self.0.len()
    }

    /// All of them.
    pub fn as_slice(&self) -> &[Fault] {
        &self.0
    }

    /// All of them, to be completed.
    pub fn as_mut_slice(&mut self) -> &mut [Fault] {
        &mut self.0
    }

    /// Whether the place `pointer` is at fault already, or one around it or in it.
    pub fn cover(&self, pointer: &str) -> bool {
        let within = |inner: &str, outer: &str| {
            let rest = inner.strip_prefix(outer);
            rest.is_some_and(|rest| rest.is_empty() || rest.starts_with('/'))
        };
        let pointers = self.0.iter().filter_map(|fault| fault.pointer.as_deref());
        pointers
            .into_iter()
            .any(|known| within(pointer, known) || within(known, pointer))
    }

    /// The faults as one problem.
    pub fn into_problem(self) -> Problem {
        let faults: Vec<Fault> = self.0.into_iter().map(Fault::bounded).collect();
        let detail = match faults.as_slice() {
            [only] => described(only),
            [first, ..] => format!("{}, and other faults: see errors", described(first)),
            [] => "the request is wrong".to_owned(),
        };
        let mut problem = Problem::new(Code::Invalid, detail);
        problem.0.faults = faults;
        problem
    }
}

fn described(fault: &Fault) -> String {
    let place = match (&fault.pointer, &fault.parameter) {
        (Some(pointer), _) if pointer.is_empty() => "the body",
        (Some(pointer), _) => pointer,
        (None, Some(parameter)) => parameter,
        (None, None) => "the request",
    };
    format!("{place} {}", fault.detail)
}

impl From<Fault> for Problem {
    fn from(fault: Fault) -> Self {
        Faults(vec![fault]).into_problem()
    }
}

/// A problem on its way to the client.
#[derive(Debug)]
pub struct Problem(Box<Contents>);

#[derive(Debug)]
struct Contents {
    code: Code,
    detail: String,
    faults: Vec<Fault>,
    members: Map<String, Value>,
}

impl Problem {
    /// A problem with what is particular to this occurrence.
    pub fn new(code: Code, detail: impl Into<String>) -> Self {
        Self(Box::new(Contents {
            code,
            detail: cut(detail.into(), DETAIL_BYTES_MAX),
            faults: vec![],
            members: Map::new(),
        }))
    }

    /// Adds an extension member.
    #[must_use]
    pub fn with(mut self, name: &str, value: impl Into<Value>) -> Self {
        self.0.members.insert(name.to_owned(), value.into());
        self
    }

    /// Adds a fault with its place.
    #[must_use]
    pub fn with_fault(mut self, fault: Fault) -> Self {
        self.0.faults.push(fault.bounded());
        self
    }

    /// Says in front of the detail where in the request it is.
    #[must_use]
    pub fn within(mut self, place: &str) -> Self {
        self.0.detail = format!("{place}: {}", self.0.detail);
        self
    }

    /// Says of the places in it that they are below another one.
    #[must_use]
    pub fn below(mut self, pointer: &str) -> Self {
        for fault in &mut self.0.faults {
            if let Some(place) = &mut fault.pointer {
                place.insert_str(0, pointer);
            }
        }
        self.within(pointer)
    }

    /// Writes the ids in it as the client has asked for them: that of a conflict, and those at fault.
    #[must_use]
    pub fn with_ids(mut self, form: IdForm) -> Self {
        if form == IdForm::Number {
            return self;
        }
        let as_text = |value: &mut Value| {
            if let Value::Number(number) = value {
                *value = Value::String(number.to_string());
            }
        };
        self.0.members.get_mut("id").into_iter().for_each(as_text);
        for fault in &mut self.0.faults {
            let place = fault.pointer.as_deref().unwrap_or_default();
            let is_id = place.ends_with("/id")
                || place.starts_with("/delete")
                || place.starts_with("/insert_id/");
            match &mut fault.value {
                Some(Value::Object(cube)) => cube.get_mut("id").into_iter().for_each(as_text),
                Some(value) if is_id => as_text(value),
                _ => {}
            }
        }
        self
    }

    /// Which type it is.
    pub fn code(&self) -> Code {
        self.0.code
    }

    /// What is particular to this occurrence.
    pub fn detail(&self) -> &str {
        &self.0.detail
    }

    /// What is wrong in the request, place by place.
    pub fn faults(&self) -> &[Fault] {
        &self.0.faults
    }

    /// Extension members.
    pub fn members(&self) -> &Map<String, Value> {
        &self.0.members
    }
}

impl From<ServiceError> for Problem {
    fn from(error: ServiceError) -> Self {
        let detail = error.to_string();
        let problem = |code| Problem::new(code, detail);
        match error {
            ServiceError::NoSuchScene(_) => problem(Code::NoSuchScene),
            ServiceError::SceneExists { settings, .. } => {
                // The text is JSON that this module's neighbour wrote; were it not, it is shown as it is.
                let settings = serde_json::from_str(&settings).unwrap_or(Value::String(settings));
                problem(Code::SceneExists).with("settings", settings)
            }
            ServiceError::Recovering { percent } => {
                problem(Code::Recovering).with("percent", percent)
            }
            ServiceError::Stopped { cause, full } => problem(if full {
                Code::DiskFull
            } else {
                Code::SceneStopped
            })
            .with("cause", cause),
            ServiceError::Damaged { cause } => problem(Code::SceneDamaged).with("cause", cause),
            ServiceError::Newer { cause } => problem(Code::SceneNewer).with("cause", cause),
            ServiceError::QueueFull { .. } => problem(Code::QueueFull),
            ServiceError::Rejected(Rejected::IdConflict { id, .. })
            | ServiceError::RejectedSolids(solids::Rejected::IdConflict { id, .. }) => {
                problem(Code::IdConflict).with("id", id.0)
            }
            ServiceError::Rejected(Rejected::TooManyCubes { .. })
            | ServiceError::RejectedSolids(solids::Rejected::TooManySolids { .. }) => {
                problem(Code::SceneFull)
            }
            ServiceError::OtherKind { .. } => problem(Code::OtherKind),
            ServiceError::TooManyOperations { .. } => problem(Code::TooLarge),
            ServiceError::KeyReused => problem(Code::KeyReused),
            ServiceError::MemoryUsed { .. } => problem(Code::MemoryUsed),
            ServiceError::TooManyScenes { .. } => problem(Code::TooManyScenes),
            ServiceError::ReadTooSlowly { .. } => problem(Code::ReadTooSlowly),
            ServiceError::SeqNotKept { oldest, .. } => {
                problem(Code::SeqNotKept).with("oldest", oldest.0)
            }
            ServiceError::NotReachable { oldest, .. } => {
                problem(Code::NotReachable).with("oldest", oldest.0)
            }
            ServiceError::SeqNotReached { newest, .. } => {
                problem(Code::SeqNotReached).with("newest", newest.0)
            }
            ServiceError::NotDefined { .. } => problem(Code::ShapeExists),
            // Never shown: a stream ends with the refusal that broke its chain.
            ServiceError::Abandoned => problem(Code::Internal),
            ServiceError::ShuttingDown => problem(Code::ShuttingDown),
            ServiceError::Storage { cause, full } => problem(if full {
                Code::DiskFull
            } else {
                Code::StorageFailed
            })
            .with("cause", cause),
        }
    }
}

/// What a problem's document has beside the members that RFC 9457 names.
#[derive(Serialize)]
struct Extensions {
    #[serde(skip_serializing_if = "Vec::is_empty")]
    errors: Vec<Fault>,
    #[serde(flatten)]
    members: Map<String, Value>,
}

impl Problem {
    /// The document, as it is the body of an answer.
    pub fn json(self) -> String {
        serde_json::to_string(&self.document()).expect("numbers and strings are JSON")
    }

    fn document(self) -> ProblemDetails<Extensions> {
        let Contents {
            code,
            detail,
            faults,
            members,
        } = *self.0;
        let kind = code.kind();
        ProblemDetails::from_status_code(code.status())
            .with_type(
                Uri::try_from(format!("/problems/{}", kind.code))
                    .expect("codes are letters and hyphens"),
            )
            .with_title(kind.title)
            .with_detail(detail)
            .with_extensions(Extensions {
                errors: faults,
                members,
            })
    }
}

impl IntoResponse for Problem {
    fn into_response(self) -> Response {
        let code = self.code();
        let kind = code.kind();
        let mut response = self.document().into_response();
        response.extensions_mut().insert(code);
        if code == Code::Unauthenticated {
            const CHALLENGE: HeaderValue = HeaderValue::from_static("Bearer realm=\"union3d\"");
            response
                .headers_mut()
                .insert(header::WWW_AUTHENTICATE, CHALLENGE);
        }
        if let Some(seconds) = kind.retry_after_seconds {
            response
                .headers_mut()
                .insert(header::RETRY_AFTER, HeaderValue::from(seconds));
        }
        response
    }
}
