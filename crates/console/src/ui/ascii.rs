//! The ASCII glyph mode: after everything is drawn, every other character is replaced.

use ratatui::buffer::Buffer;

/// Replaces every cell that is not ASCII.
pub fn flatten(buffer: &mut Buffer) {
    for cell in &mut buffer.content {
        if !cell.symbol().is_ascii() {
            let plain = cell.symbol().chars().next().map_or(' ', plain);
            cell.set_char(plain);
        }
    }
}

fn plain(character: char) -> char {
    match character {
        '─' => '-',
        '│' => '|',
        '┌' | '┐' | '└' | '┘' => '+',
        '●' | '•' | '✓' => '*',
        '◐' | '…' => '~',
        '○' => 'o',
        '↑' => '^',
        '↓' => 'v',
        '✖' => 'X',
        '▌' | '›' => '>',
        '▁' | '▂' => '_',
        '▃' | '▄' | '▅' => '=',
        '▆' | '▇' | '█' => '#',
        '▀' => '"',
        '\u{2800}' => ' ',
        '\u{2801}'..='\u{28ff}' => dots(character),
        _ => '?',
    }
}

/// A Braille pattern by how many of its eight dots are set.
fn dots(pattern: char) -> char {
    match (u32::from(pattern) & 0xff).count_ones() {
        1 | 2 => '.',
        3..=5 => ':',
        _ => '#',
    }
}
