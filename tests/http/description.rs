//! The description of the API, health and metrics.

use std::collections::BTreeSet;

use serde_json::Value;
use union3d::wire::{http, problem};

use crate::server::{JSON, Server, send};

/// All values of `$ref` in a document.
fn references<'a>(value: &'a Value, found: &mut Vec<&'a str>) {
    match value {
        Value::Object(members) => {
            for (name, value) in members {
                match value.as_str() {
                    Some(reference) if name == "$ref" => found.push(reference),
                    _ => references(value, found),
                }
            }
        }
        Value::Array(values) => values.iter().for_each(|value| references(value, found)),
        _ => {}
    }
}

#[tokio::test]
async fn the_description_is_whole() {
    let server = Server::start().await;
    let description = server.get("/openapi.json").await.ok();
    assert!(description["openapi"].as_str().unwrap().starts_with("3.1."));
    assert_eq!(description["info"]["version"], env!("CARGO_PKG_VERSION"));
    let mut found = vec![];
    references(&description, &mut found);
    assert!(found.len() > 20);
    for reference in found {
        let target = description.pointer(reference.strip_prefix('#').unwrap());
        assert!(target.is_some(), "{reference} leads nowhere");
    }
    let described: BTreeSet<_> = description["paths"].as_object().unwrap().keys().collect();
    let served: BTreeSet<_> = http::paths().iter().map(|path| path.to_string()).collect();
    assert_eq!(described, served.iter().collect());
}

/// A call that is described is served, a method that is not described is not; and every answer of this test is described.
#[tokio::test]
async fn the_description_and_the_server_agree_on_methods() {
    let server = Server::start().await;
    let scene = server.scene("pocket", 2).await;
    server
        .change(&scene, r#"{"insert":[{"id":18,"at":[0,0,0]}]}"#)
        .await
        .ok();
    let description = server.get("/openapi.json").await.ok();
    for (path, item) in description["paths"].as_object().unwrap() {
        let concrete = path
            .replace("{scene}", "pocket")
            .replace("{id}", "18")
            .replace("{code}", "id-conflict");
        for method in ["get", "put", "post", "delete", "patch"] {
            let described = item.get(method);
            if path.ends_with("/stream") && method == "get" {
                continue;
            }
            // Without a body: what wants one refuses the request, by a described answer.
            let query = if path.ends_with("/contains") {
                "?at=0,0,0"
            } else {
                ""
            };
            let request = server.request(&method.to_uppercase(), &format!("{concrete}{query}"));
            let request = if method == "delete" && path.ends_with("{scene}") {
                // The last call would take the scene from the others.
                server.request("DELETE", "/v1/scenes/none")
            } else {
                request
            };
            let answer = send(request).await;
            let Some(operation) = described else {
                answer.problem(405, "method-not-allowed");
                continue;
            };
            let status = answer.status.to_string();
            let response = &operation["responses"][&status];
            assert!(
                response.is_object(),
                "{method} {path} answers {status}, which is not described"
            );
            let kind = answer.header("content-type").split(';').next().unwrap();
            if !answer.text.is_empty() {
                let content = response["content"].as_object().unwrap();
                let named = content
                    .keys()
                    .any(|key| key.split(';').next() == Some(kind));
                assert!(
                    named,
                    "{method} {path} answers {kind}, which is not described"
                );
            }
        }
    }
}

#[tokio::test]
async fn every_problem_is_described_and_explained() {
    let server = Server::start().await;
    let description = server.get("/openapi.json").await.text;
    for kind in problem::KINDS {
        let path = format!("/problems/{}", kind.code);
        let explained = server.get(&path).await.ok();
        assert_eq!(explained["status"], kind.status);
        // The router's own answers belong to no operation.
        if kind.code != "method-not-allowed" {
            assert!(description.contains(&path), "{path} is described nowhere");
        }
    }
    let all = server.get("/problems").await.ok();
    assert_eq!(
        all["problems"].as_array().unwrap().len(),
        problem::KINDS.len()
    );
}

#[tokio::test]
async fn the_page_needs_nobody_else() {
    let server = Server::start().await;
    let page = server.get("/docs/").await;
    assert_eq!(page.status, 200);
    assert!(page.header("content-type").starts_with("text/html"));
    assert!(page.text.contains("<title>union3d"), "{}", page.text);
    assert!(page.text.contains("<a href=\"/\">"), "{}", page.text);
    let script = server.get("/docs/swagger-initializer.js").await;
    assert!(script.text.contains("/openapi.json"), "{}", script.text);
    for asset in page.text.split('"').filter(|part| part.starts_with("./")) {
        let asset = asset.trim_start_matches("./");
        assert_eq!(
            server.get(&format!("/docs/{asset}")).await.status,
            200,
            "{asset}"
        );
    }
    for text in [page.text, script.text] {
        assert!(
            !text.contains("https://") && !text.contains("http://"),
            "{text}"
        );
    }
}

#[tokio::test]
async fn health_and_metrics_are_served() {
    let server = Server::start().await;
    assert_eq!(server.get("/healthz").await.ok()["status"], "ok");
    let ready = server.get("/readyz").await.ok();
    assert_eq!(ready["ready"], true);
    let scene = server.scene("metered", 2).await;
    server
        .change(&scene, r#"{"insert":[{"id":1,"at":[0,0,0]}]}"#)
        .await
        .ok();
    server
        .send("DELETE", "/v1/scenes/none", JSON, "")
        .await
        .problem(404, "no-such-scene");
    let metrics = server.get("/metrics").await;
    assert_eq!(metrics.status, 200);
    assert!(
        metrics
            .header("content-type")
            .starts_with("text/plain; version=0.0.4")
    );
    for line in [
        r#"union3d_http_requests_total{method="POST",route="/v1/scenes/{scene}/changes",status="200"}"#,
        r#"union3d_http_requests_total{method="DELETE",route="/v1/scenes/{scene}",status="404"}"#,
        "# TYPE union3d_http_request_duration_seconds histogram",
    ] {
        assert!(metrics.text.contains(line), "no {line} in {}", metrics.text);
    }
    assert!(
        !metrics.text.contains("metered"),
        "a scene's name is a label"
    );
}

#[tokio::test]
async fn every_answer_has_an_id() {
    let server = Server::start().await;
    let own = server.get("/healthz").await;
    assert_eq!(own.header("x-request-id").len(), 36);
    assert_eq!(own.header("x-content-type-options"), "nosniff");
    let given = server
        .request("GET", "/nowhere")
        .header("x-request-id", "mine-7");
    let given = send(given).await;
    given.problem(404, "no-such-path");
    assert_eq!(given.header("x-request-id"), "mine-7");
}
