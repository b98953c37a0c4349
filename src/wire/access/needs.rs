//! What each call needs: one table for both protocols.

use axum::http::Method;

use super::keys::Right;

/// What a call needs, where there are keys.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Need {
    /// No key: it tells nothing of what is in the service.
    Nothing,
    /// Any key; what it answers is what the key may read.
    AnyKey,
    /// A key with this right on the scene that the call names.
    Scene(Right),
    /// A key with this right on all scenes.
    All(Right),
}

/// A call over HTTP (method and path), gRPC (method of `union3d.v1.UnionService`), or both, and what it needs.
#[derive(Clone, Copy, Debug)]
pub struct Call {
    /// Its name in logs, where a call over HTTP alone has that of its operation.
    pub name: &'static str,
    /// Method and path; empty when it is not there.
    pub http: &'static str,
    /// Whether it is a method of gRPC, of that name.
    pub grpc: bool,
    /// What it needs.
    pub need: Need,
}

const READ: Need = Need::Scene(Right::Read);
const WRITE: Need = Need::Scene(Right::Write);
const ADMIN: Need = Need::Scene(Right::Admin);

const fn both(name: &'static str, http: &'static str, need: Need) -> Call {
    Call {
        name,
        http,
        grpc: true,
        need,
    }
}

const fn http(name: &'static str, http: &'static str, need: Need) -> Call {
    Call {
        name,
        http,
        grpc: false,
        need,
    }
}

/// All calls. A dry run goes the way of a change, into the queue of the scene, and needs what that needs. An audit changes nothing.
pub const CALLS: &[Call] = &[
    both("CreateScene", "PUT /v1/scenes/{scene}", ADMIN),
    both("DeleteScene", "DELETE /v1/scenes/{scene}", ADMIN),
    both("ApplyChange", "POST /v1/scenes/{scene}/changes", WRITE),
    http("ApplyBatch", "POST /v1/scenes/{scene}/changes/batch", WRITE),
    both("StreamChanges", "", WRITE),
    both("RevertScene", "POST /v1/scenes/{scene}/revert", WRITE),
    both(
        "DefineShape",
        "PUT /v1/scenes/{scene}/shapes/{shape}",
        WRITE,
    ),
    http("DeleteCube", "DELETE /v1/scenes/{scene}/cubes/{id}", WRITE),
    http(
        "DeleteSolid",
        "DELETE /v1/scenes/{scene}/solids/{id}",
        WRITE,
    ),
    both("GetScene", "GET /v1/scenes/{scene}", READ),
    both(
        "GetMassProperties",
        "GET /v1/scenes/{scene}/mass-properties",
        READ,
    ),
    both(
        "WatchMassProperties",
        "GET /v1/scenes/{scene}/mass-properties/stream",
        READ,
    ),
    both("GetHistory", "GET /v1/scenes/{scene}/history", READ),
    both("ListCubes", "GET /v1/scenes/{scene}/cubes", READ),
    both("GetCube", "GET /v1/scenes/{scene}/cubes/{id}", READ),
    both("ListSolids", "GET /v1/scenes/{scene}/solids", READ),
    both("GetSolid", "GET /v1/scenes/{scene}/solids/{id}", READ),
    both("Contains", "GET /v1/scenes/{scene}/contains", READ),
    http("GetMesh", "GET /v1/scenes/{scene}/mesh", READ),
    http("GetBackup", "GET /v1/scenes/{scene}/backup", READ),
    http("GetSlice", "GET /v1/scenes/{scene}/slice", READ),
    // Of two scenes, which the handler looks at.
    http("GetOverlay", "GET /v1/overlay", Need::AnyKey),
    both("AuditScene", "POST /v1/scenes/{scene}/audit", READ),
    both("ListScenes", "GET /v1/scenes", Need::AnyKey),
    http("GetMetrics", "GET /metrics", Need::All(Right::Read)),
    http("GetHealth", "GET /healthz", Need::Nothing),
    http("GetReadiness", "GET /readyz", Need::Nothing),
    // What the program is, which everybody may know; and a browser has no key when it opens a page.
    http("GetDescription", "GET /openapi.json", Need::Nothing),
    http("GetPage", "GET /docs", Need::Nothing),
    http("GetPage", "GET /docs/", Need::Nothing),
    http("GetPage", "GET /docs/{*rest}", Need::Nothing),
    http("GetPage", "GET /", Need::Nothing),
    http("GetPage", "GET /scenes/{scene}", Need::Nothing),
    http("GetPage", "GET /assets/{file}", Need::Nothing),
    http("GetProblems", "GET /problems", Need::Nothing),
    http("GetProblem", "GET /problems/{code}", Need::Nothing),
];

/// What is no call: it is answered that it is none, to those who have a key.
const UNKNOWN: Call = Call {
    name: "other",
    http: "",
    grpc: false,
    need: Need::AnyKey,
};

/// Health and reflection, which belong to gRPC itself: of the same kind as `/readyz` and `/openapi.json`.
const OF_THE_PROTOCOL: Call = Call {
    need: Need::Nothing,
    ..UNKNOWN
};

/// The call over HTTP, by the path of its route; none is known to be without a path.
pub(in crate::wire) fn of_http(method: &Method, route: Option<&str>) -> &'static Call {
    // Where there is a GET there is a HEAD.
    let method = if method == Method::HEAD {
        &Method::GET
    } else {
        method
    };
    let is_it =
        |call: &&Call| call.http.split_once(' ') == route.map(|route| (method.as_str(), route));
    let found = route.and_then(|_| CALLS.iter().find(is_it));
    found.unwrap_or(&UNKNOWN)
}

/// The call over gRPC, by the path that it is sent to.
pub(in crate::wire) fn of_grpc(path: &str) -> &'static Call {
    if path.starts_with("/grpc.health.") || path.starts_with("/grpc.reflection.") {
        return &OF_THE_PROTOCOL;
    }
    let name = path.strip_prefix("/union3d.v1.UnionService/");
    let is_it = |call: &&Call| call.grpc && Some(call.name) == name;
    CALLS.iter().find(is_it).unwrap_or(&UNKNOWN)
}
