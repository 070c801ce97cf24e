use super::*;

fn page() -> Page {
    let bars = Mark::Bars(vec![Bar::between(3.0, 1.0, 5.0), None, Bar::plain(f64::NAN)]);
    let line = Mark::Line(vec![(0.5, 99.9), (2.5, 100.0)]);
    let series = vec![Series::new("ours <&>", COLOURS[0], bars), Series::new("success", COLOURS[3], line)];
    let plot = Plot {
        title: "what's <this>?".to_owned(),
        across: Axis::places("size", ["1 KB", "a \"b\"", "x"].map(str::to_owned)),
        left: Axis::decades("ms", series[0].values()),
        right: Some(Axis::from_zero("%", series[1].values())),
        series,
    };
    let values: Vec<f64> = (0..300).map(|value| 6.19 + f64::from(value % 17) / 100.0).collect();
    let plots = vec![
        plot,
        histogram("of one", &[7.0], "us"),
        histogram("of many", &values, "us"),
        histogram("of none", &[], "us"),
    ];
    let notes = vec!["long ".repeat(100), "short".to_owned()];
    Page { title: "a & b".to_owned(), machine: "<machine>".to_owned(), columns: 2, plots, notes }
}

#[test]
fn a_page_holds_its_texts_escaped_and_no_position_that_is_not_a_number() {
    let document = page().draw().expect("drawn");
    assert!(document.starts_with("<svg") && document.trim_end().ends_with("</svg>"));
    assert!(!document.contains("NaN") && !document.contains("inf\""), "{document}");
    for text in ["a &amp; b", "&lt;machine&gt;", "ours &lt;&amp;&gt;", "of many", "frequency, %", "1 KB", "short"] {
        assert!(document.contains(text), "{text}: {document}");
    }
}

#[test]
fn what_is_drawn_lies_on_the_page() {
    let document = page().draw().expect("drawn");
    let numbers = |name: &str| {
        let begin = format!(" {name}=\"");
        let found = document.split(&begin).skip(1).filter_map(|rest| rest.split('"').next());
        found.filter_map(|number| number.parse::<f64>().ok()).collect::<Vec<_>>()
    };
    let (width, height) = (numbers("width")[0], numbers("height")[0]);
    assert!(width >= f64::from(WIDTH) && !numbers("x").is_empty());
    assert!(numbers("x").iter().all(|x| (0.0..=width).contains(x)));
    assert!(numbers("y").iter().all(|y| (0.0..=height).contains(y)));
}

#[test]
fn a_histogram_counts_every_value() {
    let values: Vec<f64> = (0..100).map(f64::from).chain([1e6]).collect();
    let plot = histogram("of outliers", &values, "us");
    let Mark::Columns(columns) = &plot.series[0].mark else { panic!("columns") };
    assert!((columns.iter().map(|column| column.2).sum::<f64>() - 101.0).abs() < 1e-9);
    assert!(columns.iter().all(|column| column.1 < 1000.0), "{plot:?}");
    assert!(plot.across.label.starts_with("us; 1 above"), "{plot:?}");
}
