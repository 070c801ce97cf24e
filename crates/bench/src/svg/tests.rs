use super::*;

fn page() -> Page {
    let bars = Mark::Bars(vec![Bar::between(3.0, 1.0, 5.0), None, Some(Bar::plain(f64::NAN))]);
    let line = Mark::Line(vec![(0.5, 99.9), (f64::INFINITY, 1.0), (2.5, 100.0)]);
    let series = vec![
        Series::new("ours <&>", COLOURS[0], bars),
        Series { side: Side::Right, ..Series::new("success", COLOURS[3], line) },
    ];
    let names = ["1 KB", "a \"b\"", "x\ny"].map(str::to_owned);
    let plot = Plot {
        title: "what's <this>?".to_owned(),
        across: Axis::places("size", names),
        left: Axis::decades("ms", series[0].values()),
        right: Some(Axis::around("%", series[1].values())),
        series,
    };
    let values: Vec<f64> = (0..300).map(|value| 6.19 + f64::from(value % 17) / 100.0).collect();
    let plots = vec![
        plot,
        histogram("of one", &[7.0], "us"),
        histogram("of many", &values, "us"),
        histogram("of none", &[], "us"),
    ];
    let notes = vec!["long ".repeat(100), "\u{1b}[31mred\u{ffff}".to_owned()];
    Page { title: "a & b".to_owned(), machine: "<machine>".to_owned(), columns: 2, plots, notes }
}

/// Every element is closed, and all text that needs it is escaped.
fn expect_well_formed(document: &str) {
    let mut open = Vec::new();
    let body = document.strip_prefix("<?xml version=\"1.0\" encoding=\"UTF-8\"?>\n").expect("a declaration");
    for part in body.split('<').skip(1) {
        let (tag, text) = part.split_once('>').expect("a tag ends");
        assert!(!text.contains('>'), "{text}");
        for (index, _) in text.match_indices('&').chain(tag.match_indices('&')) {
            let from = if text.is_char_boundary(index) && text[index..].starts_with('&') { text } else { tag };
            let entity = from[index..].split(';').next().unwrap_or_default();
            assert!(["&amp", "&lt", "&gt", "&quot", "&#39"].contains(&entity), "{entity}");
        }
        match tag.strip_prefix('/') {
            Some(name) => assert_eq!(open.pop(), Some(name), "{tag}"),
            None if tag.ends_with('/') => {}
            None => open.push(tag.split(' ').next().unwrap_or_default()),
        }
    }
    assert!(open.is_empty(), "{open:?}");
}

#[test]
fn a_page_is_well_formed_whatever_is_in_it() {
    let document = page().draw();
    expect_well_formed(&document);
    assert!(!document.contains("NaN") && !document.contains("inf"), "{document}");
    assert!(!document.contains('\u{1b}') && !document.contains('\u{ffff}'));
    assert!(document.contains("ours &lt;&amp;&gt;") && document.contains("what&#39;s &lt;this&gt;?"));
}

#[test]
fn what_is_drawn_lies_on_the_page() {
    let document = page().draw();
    let numbers = |name: &str| {
        let begin = format!(" {name}=\"");
        let found = document.split(&begin).skip(1).filter_map(|rest| rest.split('"').next());
        found.filter_map(|number| number.parse::<f64>().ok()).collect::<Vec<_>>()
    };
    let height = numbers("height")[0];
    assert!(numbers("x").iter().all(|x| (0.0..=WIDTH).contains(x)));
    assert!(numbers("y").iter().all(|y| (0.0..=height).contains(y)));
}

#[test]
fn a_histogram_counts_every_value() {
    let values: Vec<f64> = (0..100).map(f64::from).chain([1e6]).collect();
    let plot = histogram("of outliers", &values, "us");
    let Mark::Columns(columns) = &plot.series[0].mark else { panic!("columns") };
    assert!((columns.iter().map(|column| column.2).sum::<f64>() - 101.0).abs() < 1e-9);
    assert!(plot.across.ticks.iter().all(|(value, _)| *value < 1000.0), "{plot:?}");
}
