//! Ids above 2^53: numbers and decimal strings in, and strings out for those who ask.

use serde_json::{Value, json};

use crate::server::{JSON, NDJSON, Server, send};

/// Above 2^53, where a float would make another number of it.
const LARGE: u64 = 9_007_199_254_740_993;

/// All values of `id` in a document.
fn ids(value: &Value) -> Vec<Value> {
    match value {
        Value::Object(members) => {
            let own = members.get("id").cloned();
            own.into_iter()
                .chain(members.values().flat_map(ids))
                .collect()
        }
        Value::Array(values) => values.iter().flat_map(ids).collect(),
        _ => vec![],
    }
}

#[tokio::test]
async fn both_forms_name_the_same_cube() {
    let server = Server::start().await;
    let scene = server.scene("s", 2).await;
    let text = json!({"insert": [{"id": LARGE.to_string(), "at": [0, 0, 0]}]});
    assert_eq!(
        server.change(&scene, &text.to_string()).await.ok()["inserted"],
        1
    );
    let number = json!({"insert": [{"id": LARGE, "at": [0, 0, 0]}]});
    assert_eq!(
        server.change(&scene, &number.to_string()).await.ok()["unchanged"],
        1
    );
    let line = format!(
        "{{\"insert\":{{\"id\":\"{}\",\"at\":[3,0,0]}}}}\n",
        LARGE + 1
    );
    assert_eq!(server.lines(&scene, &line).await.ok()["inserted"], 1);
    let line = format!("{{\"delete\":\"{}\"}}\n", LARGE + 1);
    assert_eq!(server.lines(&scene, &line).await.ok()["deleted"], 1);
    let body = json!({"delete": [LARGE.to_string()]}).to_string();
    assert_eq!(server.change(&scene, &body).await.ok()["deleted"], 1);
    for id in [
        "\"x\"",
        "\"01\"",
        "\"-1\"",
        "\"18446744073709551616\"",
        "\"\"",
        "1.0",
    ] {
        let answer = server
            .change(&scene, &format!("{{\"delete\":[{id}]}}"))
            .await;
        assert_eq!(answer.places(), ["/delete/0"], "{id}");
    }
}

#[tokio::test]
async fn ids_are_answered_as_text_when_asked() {
    let server = Server::start().await;
    let scene = server.scene("s", 2).await;
    let path = |rest: &str| format!("{scene}/{rest}");
    let body = json!({"insert": [{"id": LARGE, "at": [0, 0, 0]}]}).to_string();
    server.change(&scene, &body).await.ok();
    let text = json!(LARGE.to_string());
    for call in [
        "cubes",
        "cubes?limit=1",
        "contains?at=1,1,1",
        &format!("cubes/{LARGE}"),
    ] {
        let and = if call.contains('?') { '&' } else { '?' };
        let shown = server.get(&path(call)).await.ok();
        assert_eq!(ids(&shown), [json!(LARGE)], "{call}");
        let shown = server
            .get(&path(&format!("{call}{and}ids=number")))
            .await
            .ok();
        assert_eq!(ids(&shown), [json!(LARGE)], "{call}");
        let shown = server
            .get(&path(&format!("{call}{and}ids=text")))
            .await
            .ok();
        assert_eq!(ids(&shown), std::slice::from_ref(&text), "{call}");
    }
    let request = server.request("GET", &path("cubes?ids=text"));
    let lines = send(request.header("accept", NDJSON)).await.text;
    assert_eq!(
        lines,
        format!("{{\"insert\":{{\"id\":{text},\"at\":[0.0,0.0,0.0]}}}}\n")
    );
    // They can be posted back as they are.
    assert_eq!(server.lines(&scene, &lines).await.ok()["unchanged"], 1);

    let changes = path("changes?ids=text");
    let body = r#"{"insert":[{"at":[0,0,0]},{"at":[0,0,0]}]}"#;
    let assigned = server.send("POST", &changes, JSON, body).await.ok()["assigned"].clone();
    let next = LARGE + 1;
    assert_eq!(
        assigned,
        json!({"first": next.to_string(), "last": (next + 1).to_string()})
    );

    let elsewhere = json!({"insert": [{"id": LARGE, "at": [5, 0, 0]}]}).to_string();
    let conflict = server.send("POST", &changes, JSON, &elsewhere).await;
    assert_eq!(
        ids(&conflict.problem(409, "id-conflict")),
        [text.clone(), text.clone()]
    );
    let conflict = server.change(&scene, &elsewhere).await;
    assert_eq!(
        ids(&conflict.problem(409, "id-conflict")),
        [json!(LARGE), json!(LARGE)]
    );
    let line = format!("{{\"insert\":{{\"id\":{LARGE},\"at\":[5,0,0]}}}}\n");
    let conflict = server.send("POST", &changes, NDJSON, &line).await;
    assert_eq!(
        ids(&conflict.problem(409, "id-conflict")),
        [text.clone(), text.clone()]
    );
    let twice = json!({"insert": [{"id": LARGE, "at": [0, 0, 0]}, {"id": LARGE, "at": [1, 0, 0]}]});
    let twice = server
        .send("POST", &changes, JSON, &twice.to_string())
        .await;
    assert_eq!(twice.problem(422, "invalid")["errors"][0]["value"], text);

    for call in [
        "cubes?ids=words",
        "cubes/1?ids=",
        "contains?at=0,0,0&ids=Text",
    ] {
        assert_eq!(server.get(&path(call)).await.places(), ["ids"], "{call}");
    }
    // Where there are no ids to answer, it is not known.
    let none = server.get(&path("history?ids=text")).await;
    assert_eq!(none.places(), ["ids"]);
}
