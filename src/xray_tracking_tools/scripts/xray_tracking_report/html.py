"""Pieces of HTML."""
import math
import os

import jinja2
from markupsafe import Markup, escape

from . import figures

FOLDER = os.path.dirname(os.path.abspath(__file__))


def page(title, parts):
    environment = jinja2.Environment(loader=jinja2.FileSystemLoader(FOLDER), autoescape=True)
    with open(os.path.join(FOLDER, 'page.css'), encoding='utf-8') as file:
        css = Markup(file.read())
    return environment.get_template('page.html').render(title=title, css=css, body=Markup('\n').join(parts))


def element(name, content, **attributes):
    text = ''.join(f' {key.rstrip("_")}="{escape(value)}"' for key, value in attributes.items())
    return Markup(f'<{name}{text}>') + escape(content) + Markup(f'</{name}>')


def heading(text, level=2):
    return element(f'h{level}', text)


def paragraph(text, **attributes):
    return element('p', text, **attributes)


def figure(svg, number, caption):
    return Markup('<figure class="wide">{}<figcaption><b>{}</b> {}</figcaption></figure>').format(
        Markup(svg), number, caption)


def table(head, rows, number='', caption='', quiet=()):
    """Cells that are numbers or dashes are aligned to the right. quiet: indices of rows that are somebody else's."""
    numeric = [all(_is_number(row[i]) for row in rows) and bool(rows) for i in range(len(head))]
    # Not a caption element: on a narrow screen that would scroll away with the table.
    text = Markup('<div class="scroll"><table>')
    if number:
        text = Markup('<p class="caption"><b>{}</b> {}</p>').format(number, caption) + text
    if any(head):
        text += Markup('<thead><tr>') + Markup('').join(
            element('th', title, class_='n' if is_number else '') for title, is_number in zip(head, numeric))
        text += Markup('</tr></thead>')
    text += Markup('<tbody>')
    for i, row in enumerate(rows):
        text += Markup('<tr class="quiet">') if i in quiet else Markup('<tr>')
        for cell, is_number in zip(row, numeric):
            long = not is_number and len(str(cell)) > 40
            text += element('td', cell, class_='n' if is_number else 'wrap' if long else '')
        text += Markup('</tr>')
    return text + Markup('</tbody></table></div>')


def _is_number(cell):
    text = str(cell)
    return text == '' or (not isinstance(cell, Markup) and text[0] in '0123456789-–+−<' and len(text) < 26)


def method_cell(name):
    return Markup(f'<span class="swatch" style="background:{figures.colour_of(name)}"></span>') + escape(
        figures.line_label(name))


def mm(value, digits=3):
    return f'{value:.{digits}f}' if value is not None and math.isfinite(value) else '–'


def percent(value):
    return f'{100 * value:.0f} %' if math.isfinite(value) else '–'


def probability(p):
    if not math.isfinite(p):
        return '–'
    return '< 0.0001' if p < 1e-4 else f'{p:.4f}' if p < 0.1 else f'{p:.2f}'


def verdict(held):
    """held: True, False, or None where it cannot be said."""
    word, style = {True: ('held', 'held'), False: ('not held', 'not'), None: ('not judged', 'open')}[held]
    return element('span', word, class_='pill ' + style)
