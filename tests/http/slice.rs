//! Slices, stacks of them, and two of them over each other.

use serde_json::{Value, json};
use union3d::wire::access::keys::Right;

use crate::keys::KeyFile;
use crate::server::{JSON, Server, send};

/// Two cubes that overlap, and one that touches them from above, cut from a stock: in half units.
async fn block() -> (Server, String) {
    let server = Server::start().await;
    let settings = r#"{"edge":2,"steps_per_unit":2,"stock":{"min":[0,0,0],"max":[8,3,3]}}"#;
    let scene = server.scene_with("block", settings).await;
    let cubes = json!({"insert": [
        {"id": 1, "at": [0, 0, 0]}, {"id": 2, "at": [1, 1, 0]}, {"id": 3, "at": [5, 0.5, 2]},
    ]});
    server.change(&scene, &cubes.to_string()).await.ok();
    (server, scene)
}

fn points(ring: &Value) -> Vec<[f64; 2]> {
    serde_json::from_value(ring.clone()).unwrap()
}

/// Twice the area of a closed ring, positive when it is counterclockwise.
fn turn(ring: &Value) -> f64 {
    let points = points(ring);
    assert_eq!(points.first(), points.last(), "a ring is closed");
    let pairs = points.windows(2);
    pairs
        .map(|pair| pair[0][0] * pair[1][1] - pair[0][1] * pair[1][0])
        .sum()
}

#[tokio::test]
async fn a_slice_is_what_a_plane_cuts() {
    let (server, scene) = block().await;
    let slice = server.get(&format!("{scene}/slice?axis=z&at=1")).await;
    assert_eq!(slice.header("etag"), {
        let totals = server.get(&format!("{scene}/mass-properties")).await;
        totals.header("etag").to_owned()
    });
    let slice = slice.ok();
    assert_eq!(slice["seq"], 1);
    assert_eq!(
        (&slice["axis"], &slice["part"]),
        (&json!("z"), &json!("union"))
    );
    assert_eq!(
        (&slice["area"], &slice["perimeter"]),
        (&json!(7.0), &json!(12.0))
    );
    let polygons = slice["polygons"].as_array().unwrap();
    assert_eq!(polygons.len(), 1);
    assert_eq!(turn(&polygons[0]["outer"]), 14.0);
    let removed = server
        .get(&format!("{scene}/slice?at=1&part=removed"))
        .await
        .ok();
    assert_eq!(removed["area"], 7.0);
    // In the plane of faces what is above counts: the tops of the two are gone, the bottom of the third is there.
    let at_face = server.get(&format!("{scene}/slice?at=2")).await.ok();
    assert_eq!(
        (&at_face["area"], &at_face["perimeter"]),
        (&json!(4.0), &json!(8.0))
    );
    let rest = server
        .get(&format!("{scene}/slice?at=2&part=remaining"))
        .await
        .ok();
    assert_eq!(
        (&rest["area"], &rest["perimeter"]),
        (&json!(20.0), &json!(30.0))
    );
    let polygon = &rest["polygons"][0];
    assert_eq!(turn(&polygon["outer"]), 48.0);
    assert_eq!(turn(&polygon["holes"][0]), -8.0);
    // The other axes have the other two coordinates, in their order.
    let along_x = server.get(&format!("{scene}/slice?axis=x&at=6")).await.ok();
    let mut outer = points(&along_x["polygons"][0]["outer"]);
    outer.pop();
    outer.sort_by(|one, other| one.partial_cmp(other).unwrap());
    assert_eq!(outer, [[0.5, 2.0], [0.5, 4.0], [2.5, 2.0], [2.5, 4.0]]);
    let along_y = server
        .get(&format!("{scene}/slice?axis=y&at=0.25"))
        .await
        .ok();
    assert_eq!(points(&along_y["polygons"][0]["outer"]).len(), 5);
    assert_eq!(along_y["area"], 4.0);
    let nothing = server.get(&format!("{scene}/slice?at=1e300")).await.ok();
    assert_eq!(
        (&nothing["area"], &nothing["polygons"]),
        (&json!(0.0), &json!([]))
    );
}

#[tokio::test]
async fn a_slice_is_drawn() {
    let (server, scene) = block().await;
    let svg = server
        .get(&format!("{scene}/slice?at=2&part=remaining&format=svg"))
        .await;
    assert_eq!(svg.header("content-type"), "image/svg+xml");
    assert!(svg.text.contains("viewBox=\"0 -3 8 3\""), "{}", svg.text);
    assert!(svg.text.contains("fill-rule=\"evenodd\""));
    assert_eq!(svg.text.matches('M').count(), 2);
    let dxf = server
        .get(&format!("{scene}/slice?at=2&part=remaining&format=dxf"))
        .await;
    assert_eq!(dxf.header("content-type"), "image/vnd.dxf");
    assert!(dxf.text.ends_with("0\nENDSEC\n0\nEOF\n"));
    assert_eq!(dxf.text.matches("POLYLINE\n").count(), 2);
    assert_eq!(dxf.text.matches("VERTEX\n").count(), 8);
    // Pairs of a code and a value.
    assert_eq!(dxf.text.lines().count() % 2, 0);
}

/// The volume is the sum of the slices of a stack, which are constant between two lattice coordinates.
#[tokio::test]
async fn a_stack_makes_the_volume() {
    let (server, scene) = block().await;
    let totals = server.totals(&scene).await;
    let parts = [
        ("union", &totals["volume"]),
        ("removed", &totals["removed"]["volume"]),
        ("remaining", &totals["remaining"]["volume"]),
    ];
    for axis in ["x", "y", "z"] {
        for (part, volume) in parts {
            let path = format!("{scene}/slice?axis={axis}&from=-1&to=9&step=0.5&part={part}");
            let stack = server.get(&path).await;
            assert_eq!(stack.status, 200);
            assert_eq!(stack.header("content-type"), "application/x-ndjson");
            let slices: Vec<Value> = stack
                .text
                .lines()
                .map(|line| serde_json::from_str(line).unwrap())
                .collect();
            assert_eq!(slices.len(), 21);
            assert_eq!(slices[1]["at"], -0.5);
            let sum: f64 = slices
                .iter()
                .map(|one| one["area"].as_f64().unwrap() / 2.0)
                .sum();
            assert_eq!(sum, volume.as_f64().unwrap(), "{part} along {axis}");
        }
    }
}

#[tokio::test]
async fn solids_are_cut_like_the_boxes_that_they_are() {
    let (server, cubes) = block().await;
    let settings = r#"{"kind":"solids","steps_per_unit":2,"stock":{"min":[0,0,0],"max":[8,3,3]},
        "shapes":{"b":{"box":[2,2,2]}}}"#;
    let solids = server.scene_with("solids", settings).await;
    let boxes = json!({"insert": [
        {"id": 1, "shape": "b", "at": [0, 0, 0]}, {"id": 2, "shape": "b", "at": [1, 1, 0]},
        {"id": 3, "shape": "b", "at": [5, 0.5, 2]},
    ]});
    server.change(&solids, &boxes.to_string()).await.ok();
    for part in ["union", "removed", "remaining"] {
        for at in ["0", "0.75", "1", "2", "2.25", "3", "4"] {
            for axis in ["x", "y", "z"] {
                let query = format!("slice?axis={axis}&at={at}&part={part}");
                let one = server.get(&format!("{cubes}/{query}")).await.ok();
                let other = server.get(&format!("{solids}/{query}")).await.ok();
                assert_eq!(one, other, "{query}");
            }
        }
    }
}

#[tokio::test]
async fn two_scenes_lie_over_each_other() {
    let (server, _) = block().await;
    let other = server
        .scene_with("other", r#"{"edge":3,"steps_per_unit":1}"#)
        .await;
    let cube = json!({"insert": [{"id": 1, "at": [1, 0, 0]}]});
    server.change(&other, &cube.to_string()).await.ok();
    let overlay = server
        .get("/v1/overlay?a=block:removed&b=other&axis=z&at=1")
        .await
        .ok();
    assert_eq!(
        overlay["a"],
        json!({"scene": "block", "part": "removed", "seq": 1})
    );
    let regions = overlay["regions"].as_array().unwrap();
    let shown: Vec<_> = regions
        .iter()
        .map(|region| (region["in"].clone(), region["area"].as_f64().unwrap()))
        .collect();
    // The cube of 3 from x = 1 to 4 has all but the first column of the two of 2.
    assert_eq!(
        shown,
        [
            (json!(["a"]), 2.0),
            (json!(["b"]), 4.0),
            (json!(["a", "b"]), 5.0)
        ]
    );
    let same = server
        .get("/v1/overlay?a=other&b=other&axis=z&at=1")
        .await
        .ok();
    assert_eq!(same["regions"].as_array().unwrap().len(), 1);
    let inches = server
        .scene_with("inches", r#"{"edge":3,"steps_per_unit":1,"unit":"in"}"#)
        .await;
    assert!(inches.ends_with("inches"));
    for (path, place) in [
        ("/v1/overlay?a=other&b=inches&at=1", "b"),
        ("/v1/overlay?a=other:removed&b=other&at=1", "a"),
        ("/v1/overlay?a=other:top&b=other&at=1", "a"),
        ("/v1/overlay?a=other&b=other", "at"),
        ("/v1/overlay?b=other&at=1", "a"),
    ] {
        assert_eq!(server.get(path).await.places(), [place], "{path}");
    }
    server
        .get("/v1/overlay?a=other&b=none&at=1")
        .await
        .problem(404, "no-such-scene");
}

#[tokio::test]
async fn what_is_no_slice_is_refused() {
    let (server, scene) = block().await;
    let bare = server.scene("bare", 2).await;
    for (path, place) in [
        (format!("{scene}/slice"), "at"),
        (format!("{scene}/slice?at=x"), "at"),
        (format!("{scene}/slice?at=inf"), "at"),
        (format!("{scene}/slice?at=1&axis=w"), "axis"),
        (format!("{scene}/slice?at=1&part=rest"), "part"),
        (format!("{scene}/slice?at=1&format=png"), "format"),
        (format!("{scene}/slice?at=1&to=2"), "to"),
        (format!("{scene}/slice?from=1&to=2"), "step"),
        (format!("{scene}/slice?from=1&to=2&step=0"), "step"),
        (format!("{scene}/slice?from=1&to=0&step=1"), "to"),
        (format!("{scene}/slice?from=0&to=1&step=1e-6"), "step"),
        (
            format!("{scene}/slice?from=0&to=1&step=1&format=svg"),
            "format",
        ),
        (format!("{bare}/slice?at=1&part=remaining"), "part"),
        (format!("{scene}/slice?at=1&height=2"), "height"),
    ] {
        assert_eq!(server.get(&path).await.places(), [place], "{path}");
    }
}

/// Who may read one scene alone is not told of another through what lies over it.
#[tokio::test]
async fn an_overlay_needs_the_right_on_both() {
    let (file, [maker, reader]) =
        KeyFile::new([("maker", Right::Admin, "*"), ("reader", Right::Read, "one")]);
    let server = Server::guarded(file.access()).await;
    let ask = async |key: &str, method: &str, path: &str, body: &str| {
        let request = server.request(method, path).header("content-type", JSON);
        let request = request.header("authorization", format!("Bearer {key}"));
        send(request.body(body.to_owned())).await
    };
    for scene in ["one", "two"] {
        let path = format!("/v1/scenes/{scene}");
        let made = ask(&maker, "PUT", &path, r#"{"edge":2,"steps_per_unit":1}"#).await;
        assert_eq!(made.status, 201);
    }
    let both = "/v1/overlay?a=one&b=one&at=0";
    ask(&reader, "GET", both, "").await.ok();
    for path in [
        "/v1/overlay?a=one&b=two&at=0",
        "/v1/overlay?a=none&b=one&at=0",
    ] {
        ask(&reader, "GET", path, "")
            .await
            .problem(403, "forbidden");
        assert_ne!(ask(&maker, "GET", path, "").await.status, 403);
    }
}
