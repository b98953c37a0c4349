//! Who may do what: keys and their rights, hosts, origins.

use std::collections::BTreeSet;

use reqwest::RequestBuilder;
use serde_json::{Value, json};
use union3d::wire::access::keys::Right;
use union3d::wire::access::{Access, CALLS, Hosts, Need};

use crate::keys::KeyFile;
use crate::server::{Answer, JSON, NDJSON, Server, send};

const CUBES: &str = r#"{"edge":2,"steps_per_unit":1}"#;
const CHANGE: &str = r#"{"insert":[{"id":1,"at":[0,0,0]}]}"#;

fn with(request: RequestBuilder, key: &str) -> RequestBuilder {
    request.header("authorization", format!("Bearer {key}"))
}

async fn ask(server: &Server, key: &str, method: &str, path: &str, body: &str) -> Answer {
    let request = with(server.request(method, path), key).header("content-type", JSON);
    send(request.body(body.to_owned())).await
}

/// Every call that is described, as it would be sent to the scene `part`.
async fn described(server: &Server) -> Vec<(String, String)> {
    let description = server.get("/openapi.json").await.ok();
    let mut found = vec![];
    for (path, item) in description["paths"].as_object().unwrap() {
        let methods = item.as_object().unwrap().keys();
        let methods = methods.filter(|name| ["get", "put", "post", "delete"].contains(&&***name));
        found.extend(methods.map(|method| (method.to_uppercase(), path.clone())));
    }
    assert!(found.len() > 20);
    found
}

fn concrete(path: &str) -> String {
    path.replace("{scene}", "part")
        .replace("{id}", "1")
        .replace("{shape}", "t1")
        .replace("{code}", "invalid")
}

#[tokio::test]
async fn every_call_stands_in_the_table_of_what_calls_need() {
    let server = Server::start().await;
    let described: BTreeSet<String> = described(&server)
        .await
        .into_iter()
        .map(|(method, path)| format!("{method} {path}"))
        .collect();
    // Pages for people are no calls of the API.
    let listed = CALLS
        .iter()
        .filter(|call| call.name != "GetPage")
        .map(|call| call.http)
        .filter(|http| !http.is_empty());
    let listed: Vec<String> = listed.map(str::to_owned).collect();
    let once: BTreeSet<String> = listed.iter().cloned().collect();
    assert_eq!(
        once.len(),
        listed.len(),
        "a call stands twice in {listed:?}"
    );
    assert_eq!(once, described);
}

/// No call but those that need nothing does anything without a key, or with one that is not known; none does anything with a key
/// that is for another scene, or that has the right before the one needed.
#[tokio::test]
async fn every_call_is_refused_to_who_has_not_the_right() {
    let (file, [other, read, write]) = KeyFile::new([
        ("other", Right::Admin, "other"),
        ("read", Right::Read, "part"),
        ("write", Right::Write, "part"),
    ]);
    let server = Server::guarded(file.access()).await;
    for (method, path) in described(&server).await {
        let call = format!("{method} {path}");
        let need = CALLS.iter().find(|one| one.http == call).unwrap().need;
        let path = concrete(&path);
        let without = server.send(&method, &path, JSON, "").await;
        if need == Need::Nothing {
            assert_eq!(without.status, 200, "{call}: {}", without.text);
            continue;
        }
        without.problem(401, "unauthenticated");
        assert_eq!(
            without.header("www-authenticate"),
            "Bearer realm=\"union3d\""
        );
        ask(&server, "u3d_unknown", &method, &path, "")
            .await
            .problem(401, "unauthenticated");
        let too_little: &[&String] = match need {
            Need::Nothing | Need::AnyKey => &[],
            Need::Scene(Right::Read) => &[&other],
            Need::Scene(Right::Write) => &[&other, &read],
            Need::Scene(Right::Admin) => &[&other, &read, &write],
            Need::All(_) => &[&other, &read, &write],
        };
        for key in too_little {
            ask(&server, key, &method, &path, "")
                .await
                .problem(403, "forbidden");
        }
    }
    // What is no call is nothing to those without a key either.
    for (method, path) in [
        ("GET", "/v1/nothing"),
        ("PATCH", "/v1/scenes/part"),
        ("DELETE", "/metrics"),
    ] {
        server
            .send(method, path, JSON, "")
            .await
            .problem(401, "unauthenticated");
    }
    ask(&server, &read, "GET", "/v1/nothing", "")
        .await
        .problem(404, "no-such-path");
    ask(&server, &read, "PATCH", "/v1/scenes/part", "")
        .await
        .problem(405, "method-not-allowed");
    assert_eq!(server.service.scenes().len(), 0);
}

#[tokio::test]
async fn each_right_does_what_it_is_for() {
    let (file, [admin, write, read, all]) = KeyFile::new([
        ("admin", Right::Admin, "part-*"),
        ("write", Right::Write, "part-1"),
        ("read", Right::Read, "part-1"),
        ("all", Right::Read, "*"),
    ]);
    let server = Server::guarded(file.access()).await;
    let scene = "/v1/scenes/part-1";
    for name in ["part-1", "part-2"] {
        let path = format!("/v1/scenes/{name}");
        assert_eq!(ask(&server, &admin, "PUT", &path, CUBES).await.status, 201);
    }
    ask(&server, &admin, "PUT", "/v1/scenes/jig", CUBES)
        .await
        .problem(403, "forbidden");
    let changes = format!("{scene}/changes");
    ask(&server, &write, "POST", &changes, CHANGE).await.ok();
    ask(&server, &read, "POST", &changes, CHANGE)
        .await
        .problem(403, "forbidden");
    ask(
        &server,
        &read,
        "POST",
        &format!("{changes}?dry_run=true"),
        CHANGE,
    )
    .await
    .problem(403, "forbidden");
    ask(&server, &write, "POST", "/v1/scenes/part-2/changes", CHANGE)
        .await
        .problem(403, "forbidden");
    // Whether a scene is there is not told to those who may not see it.
    let unseen = ask(&server, &write, "GET", "/v1/scenes/part-2", "").await;
    let absent = ask(&server, &write, "GET", "/v1/scenes/part-3", "").await;
    assert_eq!(
        unseen.problem(403, "forbidden")["detail"]
            .as_str()
            .unwrap()
            .replace("part-2", "part-3"),
        absent.problem(403, "forbidden")["detail"]
    );
    // Another way to write the same name is the same scene.
    ask(&server, &write, "GET", "/v1/scenes/%70art-2", "")
        .await
        .problem(403, "forbidden");
    ask(&server, &write, "GET", "/v1/scenes/%70art-1", "")
        .await
        .ok();

    let totals = ask(
        &server,
        &read,
        "GET",
        &format!("{scene}/mass-properties"),
        "",
    )
    .await;
    assert_eq!(totals.ok()["cubes"], 1);
    ask(&server, &read, "POST", &format!("{scene}/audit"), "")
        .await
        .ok();
    for (key, seen) in [
        (&admin, json!(["part-1", "part-2"])),
        (&read, json!(["part-1"])),
        (&all, json!(["part-1", "part-2"])),
    ] {
        let list = ask(&server, key, "GET", "/v1/scenes", "").await.ok();
        let names: Vec<&Value> = list["scenes"]
            .as_array()
            .unwrap()
            .iter()
            .map(|scene| &scene["name"])
            .collect();
        assert_eq!(json!(names), seen);
    }
    ask(&server, &admin, "GET", "/metrics", "")
        .await
        .problem(403, "forbidden");
    assert_eq!(ask(&server, &all, "GET", "/metrics", "").await.status, 200);
    ask(&server, &write, "DELETE", scene, "")
        .await
        .problem(403, "forbidden");
    assert_eq!(ask(&server, &admin, "DELETE", scene, "").await.status, 204);
}

/// A stream of events is for those who may read, and ends with their right.
#[tokio::test]
async fn streams_are_for_those_who_may() {
    let (file, [admin, read]) =
        KeyFile::new([("admin", Right::Admin, "*"), ("read", Right::Read, "part")]);
    let access = file.access();
    let server = Server::guarded(access.clone()).await;
    ask(&server, &admin, "PUT", "/v1/scenes/part", CUBES).await;
    let stream = "/v1/scenes/part/mass-properties/stream";
    server.get(stream).await.problem(401, "unauthenticated");
    let mut events = with(server.request("GET", stream), &read)
        .send()
        .await
        .unwrap();
    assert_eq!(events.status(), 200);
    let first = events.chunk().await.unwrap().unwrap();
    assert!(first.starts_with(b"id: 0"), "{first:?}");
    let lines = with(server.request("POST", "/v1/scenes/part/changes"), &read);
    let refused = send(
        lines
            .header("content-type", NDJSON)
            .body("{\"delete\":1}\n"),
    )
    .await;
    refused.problem(403, "forbidden");

    // The key is taken back: what happens then is not told any more.
    let text = std::fs::read_to_string(&file.path).unwrap();
    let kept = text
        .lines()
        .filter(|line| !line.starts_with("read"))
        .collect::<String>();
    std::fs::write(&file.path, kept).unwrap();
    access.reload();
    ask(&server, &admin, "POST", "/v1/scenes/part/changes", CHANGE)
        .await
        .ok();
    while let Ok(Some(event)) = events.chunk().await {
        assert!(
            !event.starts_with(b"id: 1"),
            "told after the key was taken back"
        );
    }
}

#[tokio::test]
async fn a_changed_file_of_keys_is_taken_up_and_a_broken_one_is_not() {
    let (file, [first]) = KeyFile::new([("first", Right::Read, "*")]);
    let access = file.access();
    let server = Server::guarded(access.clone()).await;
    let is_let_in =
        async |key: &str| ask(&server, key, "GET", "/v1/scenes", "").await.status == 200;
    let warnings = async || server.get("/readyz").await.ok()["warnings"].clone();
    assert!(is_let_in(&first).await);
    assert_eq!(warnings().await, json!([]));

    let (other, [second]) = KeyFile::new([("second", Right::Read, "*")]);
    std::fs::copy(&other.path, &file.path).unwrap();
    access.reload();
    assert!(!is_let_in(&first).await && is_let_in(&second).await);

    let good = std::fs::read_to_string(&file.path).unwrap();
    for broken in ["first = {", ""] {
        std::fs::write(&file.path, broken).unwrap();
        if broken.is_empty() {
            std::fs::remove_file(&file.path).unwrap();
        }
        access.reload();
        assert!(is_let_in(&second).await, "{broken:?}");
        assert_eq!(warnings().await.as_array().unwrap().len(), 1, "{broken:?}");
    }
    std::fs::write(&file.path, good).unwrap();
    access.reload();
    assert!(is_let_in(&second).await);
    assert_eq!(warnings().await, json!([]));
    // A file without keys lets nobody in.
    std::fs::write(&file.path, "").unwrap();
    access.reload();
    assert!(!is_let_in(&second).await);
}

#[tokio::test]
async fn what_is_not_one_bearer_key_is_no_key() {
    let (file, [key]) = KeyFile::new([("key", Right::Read, "*")]);
    let server = Server::guarded(file.access()).await;
    let scenes = || server.request("GET", "/v1/scenes");
    assert_eq!(
        send(scenes().header("authorization", format!("bearer {key}")))
            .await
            .status,
        200
    );
    for value in [
        key.clone(),
        format!("Basic {key}"),
        "Bearer".to_owned(),
        format!("Bearer {key}x"),
        format!("Bearer {}", &key[1..]),
        format!("Bearer {key} {key}"),
    ] {
        let answer = send(scenes().header("authorization", &value)).await;
        let problem = answer.problem(401, "unauthenticated");
        assert!(!problem.to_string().contains(&key[4..]), "{problem}");
    }
    let twice = with(with(scenes(), &key), "u3d_other");
    send(twice).await.problem(401, "unauthenticated");
    // Nor anywhere else.
    server
        .get(&format!("/v1/scenes?key={key}"))
        .await
        .problem(401, "unauthenticated");
}

/// Whether all is well is told to everybody, what is not well only to those who may read it.
#[tokio::test]
async fn readiness_tells_no_names_to_those_without_a_key() {
    let (file, [all, other]) =
        KeyFile::new([("all", Right::Read, "*"), ("other", Right::Read, "other")]);
    let directory = tempfile::tempdir().unwrap();
    let scene = directory.path().join("scenes/hidden");
    std::fs::create_dir_all(&scene).unwrap();
    std::fs::write(scene.join("scene.sqlite"), "no database").unwrap();
    let server = Server::guarded_on(directory, file.access()).await;
    let open = server.get("/readyz").await;
    assert_eq!(open.ok()["troubled"], json!([]));
    let ready = async |key: &str| ask(&server, key, "GET", "/readyz", "").await.ok();
    assert_eq!(ready(&all).await["troubled"][0]["scene"], "hidden");
    assert_eq!(ready(&other).await["troubled"], json!([]));
    // A probe that sends a stale key is told the same as one without.
    assert_eq!(ready("u3d_stale").await["troubled"], json!([]));
}

/// A page that points a name of its own at this server gets nothing, whatever it asks; nor does a page of another origin.
#[tokio::test]
async fn strangers_hosts_and_origins_are_refused_on_every_call() {
    let server = Server::start().await;
    server.scene("part", 2).await;
    for (method, path) in described(&server).await {
        let path = concrete(&path);
        let stranger = server
            .request(&method, &path)
            .header("host", "evil.example:7373");
        send(stranger).await.problem(421, "host-not-allowed");
        let page = server
            .request(&method, &path)
            .header("origin", "http://evil.example");
        send(page).await.problem(403, "origin-not-allowed");
    }
    assert_eq!(
        server.get("/v1/scenes").await.ok()["scenes"]
            .as_array()
            .unwrap()
            .len(),
        1
    );
    let own = format!("http://{}", server.address);
    send(server.request("GET", "/v1/scenes").header("origin", own))
        .await
        .ok();
    let by_name = server.address.replace("127.0.0.1", "localhost");
    send(server.request("GET", "/v1/scenes").header("host", by_name))
        .await
        .ok();
}

/// A form can send text, a form or parts, to any address and without asking first.
#[tokio::test]
async fn no_form_can_change_anything() {
    let server = Server::start().await;
    let scene = server.scene("part", 2).await;
    for call in ["changes", "revert", "audit"] {
        for kind in [
            "text/plain",
            "application/x-www-form-urlencoded",
            "multipart/form-data; boundary=x",
        ] {
            let path = format!("{scene}/{call}");
            let refused = server.send("POST", &path, kind, "{}").await;
            refused.problem(415, "unsupported-media-type");
        }
        send(server.request("POST", &format!("{scene}/{call}")))
            .await
            .problem(415, "unsupported-media-type");
    }
}

/// A browser asks first whether a page of another origin may ask, and keeps the answer from the page where nothing says that it may.
#[tokio::test]
async fn pages_of_allowed_origins_may_ask() {
    const PAGE: &str = "http://localhost:3000";
    let question = |server: &Server, path: &str, origin: &str| {
        server
            .request("OPTIONS", path)
            .header("origin", origin)
            .header("access-control-request-method", "POST")
            .header(
                "access-control-request-headers",
                "content-type,authorization",
            )
    };
    let closed = Server::start().await;
    let refused = question(&closed, "/v1/scenes/part/changes", PAGE)
        .send()
        .await
        .unwrap();
    assert_eq!(refused.status(), 403);
    assert!(
        refused
            .headers()
            .get("access-control-allow-origin")
            .is_none()
    );

    let (file, [key]) = KeyFile::new([("key", Right::Admin, "*")]);
    let hosts = Hosts::new(vec![], vec![], vec![PAGE.parse().unwrap()]);
    let server = Server::guarded(Access::new(hosts, Some(&file.path)).unwrap()).await;
    let yes = question(&server, "/v1/scenes/part/changes", PAGE)
        .send()
        .await
        .unwrap();
    assert_eq!(yes.status(), 204);
    let said = |name: &str| yes.headers()[name].to_str().unwrap().to_ascii_lowercase();
    assert_eq!(said("access-control-allow-origin"), PAGE);
    assert!(said("access-control-allow-methods").contains("post"));
    assert!(said("access-control-allow-headers").contains("authorization"));
    assert_eq!(
        question(&server, "/v1/scenes", "http://localhost:3001")
            .send()
            .await
            .unwrap()
            .status(),
        403
    );

    ask(&server, &key, "PUT", "/v1/scenes/part", CUBES).await;
    for (path, key, status) in [
        ("/v1/scenes/part", &*key, 200),
        ("/v1/scenes/part", "none", 401),
        ("/v1/scenes/none", &key, 404),
        ("/v1/scenes/part/mass-properties/stream", &key, 200),
    ] {
        let answer = with(server.request("GET", path), key)
            .header("origin", PAGE)
            .send()
            .await
            .unwrap();
        assert_eq!(answer.status(), status, "{path}");
        assert_eq!(
            answer.headers()["access-control-allow-origin"],
            PAGE,
            "{path}"
        );
        assert!(
            answer.headers()["access-control-expose-headers"]
                .to_str()
                .unwrap()
                .contains("etag")
        );
    }
    // Who is no page is told nothing of pages.
    let plain = ask(&server, &key, "GET", "/v1/scenes", "").await;
    assert_eq!(plain.header("access-control-allow-origin"), "");
}
