//! The description of the API: OpenAPI 3.1, made from the handlers themselves.
//!
//! What each call may fail with is one table here, joined with the table of problems: status, document and an example each.

use std::collections::BTreeMap;
use std::sync::OnceLock;

use axum::http::{Method, header};
use axum::response::{IntoResponse, Response};
use serde_json::{Map, Value, json};
use utoipa::openapi::path::Operation;
use utoipa::openapi::security::{HttpAuthScheme, HttpBuilder, SecurityRequirement, SecurityScheme};
use utoipa::openapi::{
    ContentBuilder, HeaderBuilder, Object, Ref, RefOr, ResponseBuilder, Type,
    example::ExampleBuilder,
};
use utoipa::{Modify, OpenApi};

use super::problem::ProblemDocument;
use super::{
    backup, batch, changes, contains, cubes, exposition, history, mesh, operate, reads, scenes,
    slice, solids,
};
use crate::wire::access::{Need, of_http};
use crate::wire::problem::{Code, Kind};

#[derive(OpenApi)]
#[openapi(
    info(
        title = "union3d",
        description = "Exact mass properties of the union of many cubes, current while cubes are inserted and deleted. \
            An answer to a change means that it is on stable storage."
    ),
    paths(
        scenes::put_scene, scenes::get_scenes, scenes::get_scene, scenes::delete_scene,
        changes::post_changes, batch::post_batch, changes::post_revert, changes::delete_cube,
        reads::get_mass_properties, reads::stream_mass_properties, history::get_history, reads::post_audit,
        backup::get_backup, mesh::get_mesh, slice::get_slice, slice::get_overlay,
        cubes::get_cube, cubes::get_cubes, contains::get_contains,
        solids::put_shape, solids::get_solid, solids::get_solids, solids::delete_solid,
        operate::get_healthz, operate::get_readyz, exposition::get_metrics, get_openapi,
        operate::get_problems, operate::get_problem,
    ),
    components(schemas(ProblemDocument)),
    modifiers(&Problems, &Keys),
    tags(
        (name = "scenes", description = "Sets of equal cubes, or of solids"),
        (name = "changes", description = "Inserting and deleting cubes or solids"),
        (name = "mass properties", description = "What is measured, now, in the past and as it changes"),
        (name = "cubes", description = "The cubes themselves"),
        (name = "solids", description = "Solids, and the shapes that they are made of"),
        (name = "pictures", description = "What the union looks like: where a plane cuts it"),
        (name = "operation", description = "For those who run the service"),
    )
)]
struct Description;

/// This description, OpenAPI 3.1
#[utoipa::path(get, path = "/openapi.json", tag = "operation",
    responses((status = 200, description = "The description", body = Object)))]
pub(super) async fn get_openapi() -> Response {
    let kind = [(header::CONTENT_TYPE, "application/json")];
    (kind, text()).into_response()
}

/// The description as text.
fn text() -> &'static str {
    static TEXT: OnceLock<String> = OnceLock::new();
    TEXT.get_or_init(|| {
        let description = serde_json::to_value(Description::openapi());
        let mut description = description.expect("a description has only strings for keys");
        flatten_schemas(&mut description);
        complete(&mut description);
        serde_json::to_string_pretty(&description).expect("it was JSON before")
    })
}

/// Makes one object of every schema that has parts flattened into it, and opens choices that need not exclude one another.
///
/// Left as `allOf`, a part that is closed (`additionalProperties: false`, as bodies have it) would refuse the members of the whole.
fn flatten_schemas(description: &mut Value) {
    let Some(schemas) = description.pointer_mut("/components/schemas") else {
        return;
    };
    // What may be of either kind of scene may fit both: deletions alone do.
    for (name, schema) in schemas.as_object_mut().into_iter().flatten() {
        if let (true, Some(schema)) = (name.starts_with("Any"), schema.as_object_mut())
            && let Some(choices) = schema.remove("oneOf")
        {
            schema.insert("anyOf".to_owned(), choices);
        }
    }
    let before = schemas.clone();
    for schema in schemas
        .as_object_mut()
        .into_iter()
        .flat_map(Map::values_mut)
    {
        if let Some(whole) = flattened(schema, &before) {
            *schema = whole;
        }
    }
}

/// One object for the parts of a schema; none when it has no parts.
fn flattened<'a>(schema: &'a Value, schemas: &'a Value) -> Option<Value> {
    let parts = schema.get("allOf")?.as_array()?;
    let mut whole = schema.clone();
    let (mut properties, mut required) = (Map::new(), Vec::new());
    for part in parts {
        // A part that may be left out as a whole is a choice of null and the part.
        let choice = part.get("oneOf").and_then(Value::as_array);
        let optional = choice.is_some();
        let chosen = |choice: &'a Vec<Value>| choice.iter().find(|part| part["type"] != "null");
        let part = choice.and_then(chosen).unwrap_or(part);
        let part = referred(part, schemas);
        let inner = flattened(part, schemas);
        let part = inner.as_ref().unwrap_or(part);
        let members = part["properties"].as_object().cloned();
        properties.extend(members.unwrap_or_default());
        if !optional {
            required.extend(part["required"].as_array().cloned().unwrap_or_default());
        }
    }
    let object = whole.as_object_mut()?;
    object.remove("allOf");
    object.insert("type".to_owned(), "object".into());
    object.insert("properties".to_owned(), properties.into());
    object.insert("required".to_owned(), required.into());
    Some(whole)
}

/// What a schema refers to, or itself.
fn referred<'a>(schema: &'a Value, schemas: &'a Value) -> &'a Value {
    let name = schema["$ref"].as_str();
    let name = name.and_then(|path| path.strip_prefix("#/components/schemas/"));
    name.map_or(schema, |name| &schemas[name])
}

/// What parameters of these names look like.
const PATTERNS: [(&str, &str); 4] = [
    ("scene", "^[a-z0-9][a-z0-9._-]{0,62}$"),
    ("shape", "^[A-Za-z0-9][A-Za-z0-9._-]{0,62}$"),
    ("after", "^a[0-9a-f]{16}$"),
    ("Idempotency-Key", "^[!-~]{1,64}$"),
];

/// Says what the types alone do not: how large whole numbers may be, what parameters look like.
fn complete(value: &mut Value) {
    match value {
        Value::Object(members) => {
            complete_numbers(members);
            complete_shapes(members);
            if members.contains_key("in") {
                complete_parameter(members);
            }
            members.values_mut().for_each(complete);
        }
        Value::Array(values) => values.iter_mut().for_each(complete),
        _ => {}
    }
}

/// What cannot be negative has 64 bits, too.
fn complete_numbers(schema: &mut Map<String, Value>) {
    let wide = schema.get("format").is_some_and(|format| format == "int64");
    if wide && schema.contains_key("minimum") {
        schema.insert("format".to_owned(), "uint64".into());
        schema.entry("maximum").or_insert_with(|| u64::MAX.into());
    }
}

/// Choices of operations are closed; messages are bytes.
fn complete_shapes(schema: &mut Map<String, Value>) {
    let choices = schema.get_mut("oneOf").and_then(Value::as_array_mut);
    for choice in choices.into_iter().flatten() {
        if choice["type"] == "object" {
            choice["additionalProperties"] = false.into();
        }
    }
    if let Some(message) = schema.get_mut("application/x-protobuf") {
        message["schema"] = json!({"type": "string", "format": "binary"});
    }
}

/// Parameters have patterns, and are never null.
fn complete_parameter(parameter: &mut Map<String, Value>) {
    let name = parameter.get("name").and_then(Value::as_str);
    let pattern = PATTERNS.iter().find(|(known, _)| Some(*known) == name);
    let Some(schema) = parameter.get_mut("schema") else {
        return;
    };
    if let Some((_, pattern)) = pattern {
        schema["pattern"] = (*pattern).into();
    }
    if let Some(types) = schema["type"].as_array() {
        schema["type"] = types[0].clone();
    }
}

/// What a call may fail with, besides [`EVERY_CALL`] and, where a scene must answer, [`EVERY_SCENE`].
fn failures(operation: &str) -> &'static [Code] {
    use Code::{
        AuditDifference, BadJson, BadProtobuf, DiskFull, Forbidden, IdConflict, KeyReused,
        MemoryUsed, NoSuchCube, NoSuchPath, NoSuchScene, NotReachable, OtherKind, QueueFull,
        ReadTooSlowly, Recovering, RequestTimeout, SceneDamaged, SceneExists, SceneFull,
        SceneStopped, SeqNotKept, SeqNotReached, ShapeExists, ShuttingDown, StorageFailed,
        TooLarge, TooManyScenes, UnsupportedMediaType, WaitTimeout,
    };
    match operation {
        "put_scene" => &[
            BadJson,
            RequestTimeout,
            SceneExists,
            OtherKind,
            TooLarge,
            UnsupportedMediaType,
            StorageFailed,
            DiskFull,
            TooManyScenes,
            MemoryUsed,
            ShuttingDown,
            Recovering,
        ],
        "post_changes" => &[
            BadJson,
            BadProtobuf,
            RequestTimeout,
            IdConflict,
            TooLarge,
            UnsupportedMediaType,
            SceneFull,
            KeyReused,
            QueueFull,
            MemoryUsed,
        ],
        "post_batch" => &[
            BadJson,
            BadProtobuf,
            RequestTimeout,
            IdConflict,
            TooLarge,
            UnsupportedMediaType,
            SceneFull,
            KeyReused,
            MemoryUsed,
        ],
        "post_revert" => &[
            BadJson,
            RequestTimeout,
            NotReachable,
            SeqNotReached,
            TooLarge,
            UnsupportedMediaType,
            KeyReused,
            QueueFull,
            MemoryUsed,
        ],
        "delete_cube" | "delete_solid" => &[QueueFull],
        "put_shape" => &[
            BadJson,
            RequestTimeout,
            ShapeExists,
            TooLarge,
            UnsupportedMediaType,
            QueueFull,
            MemoryUsed,
        ],
        "get_mass_properties" => &[SeqNotKept, SeqNotReached, WaitTimeout],
        "get_history" => &[SeqNotKept],
        "get_cube" | "get_solid" => &[NoSuchCube],
        "post_audit" => &[
            AuditDifference,
            BadJson,
            RequestTimeout,
            TooLarge,
            UnsupportedMediaType,
            QueueFull,
            MemoryUsed,
        ],
        "get_cubes" | "get_solids" => &[ReadTooSlowly],
        "get_mesh" => &[MemoryUsed, ReadTooSlowly, StorageFailed, DiskFull],
        "get_slice" => &[ReadTooSlowly, MemoryUsed],
        "get_overlay" => &[
            Forbidden,
            NoSuchScene,
            Recovering,
            SceneStopped,
            SceneDamaged,
            DiskFull,
            ShuttingDown,
            ReadTooSlowly,
            MemoryUsed,
        ],
        "get_backup" => &[StorageFailed, DiskFull],
        "get_readyz" => &[Recovering],
        "get_problem" => &[NoSuchPath],
        _ => &[],
    }
}

/// What every call may fail with.
const EVERY_CALL: &[Code] = &[
    Code::Internal,
    Code::AnswerTimeout,
    Code::BadRequest,
    Code::HostNotAllowed,
    Code::OriginNotAllowed,
];

/// What every call with a query or a path may fail with.
const EVERY_PARAMETER: &[Code] = &[Code::BadRequest, Code::Invalid];

/// What every call to a scene may fail with.
const EVERY_SCENE: &[Code] = &[
    Code::NoSuchScene,
    Code::OtherKind,
    Code::Recovering,
    Code::SceneStopped,
    Code::SceneDamaged,
    Code::SceneNewer,
    Code::DiskFull,
    Code::ShuttingDown,
];

struct Problems;

impl Modify for Problems {
    fn modify(&self, description: &mut utoipa::openapi::OpenApi) {
        for (path, item) in &mut description.paths.paths {
            let operations = [
                (Method::GET, &mut item.get),
                (Method::PUT, &mut item.put),
                (Method::POST, &mut item.post),
                (Method::DELETE, &mut item.delete),
            ];
            for (method, operation) in operations {
                if let Some(operation) = operation {
                    let need = of_http(&method, Some(path)).need;
                    add_failures(path, need, operation);
                    add_security(need, operation);
                }
            }
        }
    }
}

/// The name of the scheme by which callers say who they are.
const KEY: &str = "key";

/// Says whether a call needs a key. On a server without keys none does, so that none is always a choice.
fn add_security(need: Need, operation: &mut Operation) {
    operation.security = Some(match need {
        Need::Nothing => vec![],
        Need::AnyKey | Need::Scene(_) | Need::All(_) => {
            let nothing: [&str; 0] = [];
            vec![
                SecurityRequirement::default(),
                SecurityRequirement::new(KEY, nothing),
            ]
        }
    });
}

struct Keys;

impl Modify for Keys {
    fn modify(&self, description: &mut utoipa::openapi::OpenApi) {
        let scheme = HttpBuilder::new()
            .scheme(HttpAuthScheme::Bearer)
            .description(Some(
                "A key of the server, if it has keys: `union3d key new` makes one. It has rights (read, write, admin) on scenes.",
            ))
            .build();
        let components = description.components.get_or_insert_default();
        components.add_security_scheme(KEY, SecurityScheme::Http(scheme));
    }
}

fn add_failures(path: &str, need: Need, operation: &mut Operation) {
    let name = operation.operation_id.clone().unwrap_or_default();
    let mut codes = [failures(&name), EVERY_CALL].concat();
    match need {
        Need::Nothing => {}
        Need::AnyKey => codes.push(Code::Unauthenticated),
        Need::Scene(_) | Need::All(_) => codes.extend([Code::Unauthenticated, Code::Forbidden]),
    }
    if path.starts_with("/v1/") {
        codes.extend_from_slice(EVERY_PARAMETER);
    }
    if path.starts_with("/v1/scenes/{scene}") && name != "put_scene" {
        codes.extend_from_slice(EVERY_SCENE);
    }
    let mut by_status: BTreeMap<u16, Vec<&Kind>> = BTreeMap::new();
    for code in codes {
        let kind = code.kind();
        let kinds = by_status.entry(kind.status).or_default();
        if !kinds.contains(&kind) {
            kinds.push(kind);
        }
    }
    for (status, kinds) in by_status {
        let response = failure(&kinds);
        operation
            .responses
            .responses
            .insert(status.to_string(), RefOr::T(response));
    }
}

/// The response of one status, which may stand for several types of problems.
fn failure(kinds: &[&Kind]) -> utoipa::openapi::Response {
    let titles: Vec<_> = kinds
        .iter()
        .map(|kind| format!("`{}`: {}", kind.code, kind.title))
        .collect();
    let example = |kind: &&Kind| {
        let document = json!({
            "type": format!("/problems/{}", kind.code),
            "title": kind.title,
            "status": kind.status,
            "detail": kind.meaning,
        });
        let example = ExampleBuilder::new()
            .summary(kind.title)
            .value(Some(document))
            .build();
        (kind.code.to_owned(), RefOr::T(example))
    };
    let content = ContentBuilder::new()
        .schema(Some(Ref::from_schema_name("Problem")))
        .examples_from_iter(kinds.iter().map(example))
        .build();
    let response = ResponseBuilder::new()
        .description(titles.join("; "))
        .content("application/problem+json", content);
    let needs_a_key = kinds.contains(&Code::Unauthenticated.kind());
    let response = if needs_a_key {
        let scheme = HeaderBuilder::new()
            .description(Some("`Bearer`, which is how a key is sent"))
            .build();
        response.header("WWW-Authenticate", scheme)
    } else {
        response
    };
    if kinds.iter().all(|kind| kind.retry_after_seconds.is_none()) {
        return response.build();
    }
    let seconds = HeaderBuilder::new()
        .schema(Some(Object::with_type(Type::Integer)))
        .description(Some("Seconds after which a retry may succeed"))
        .build();
    response.header("Retry-After", seconds).build()
}
