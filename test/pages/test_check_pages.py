"""The checker of the pages notices what does not exist, and lets pass what does."""

import check_pages
import pytest
import said_messages


def mistakes(text: str) -> list[str]:
    return [f'{item.line}: {item.message}' for item in check_pages.check_page(text, 'page.md')]


def shell(*lines: str) -> str:
    return '\n'.join(['```sh', *lines, '```'])


@pytest.mark.parametrize(
    'line',
    [
        'incremental_mapper map my_bag out --config config/kaist.yaml --strategy mom',
        "incremental_mapper evaluate 'table_out/drives/a' b --out c --strategies base,mom --jobs 2",
        'incremental_mapper plot graph out --from 3.2 --to 4.0 --out graph.svg  # a comment',
        '.venv/bin/incremental_mapper inspect out 50 && make demo DEMO_SECONDS=5',
        'make table TIMING=some_folder JOBS=2',
        "pip install '.[report,ros]'",
        "python3 -m venv env && env/bin/pip install 'numpy<2' ./incremental_mapper",
        'python examples/figure2.py docs/figure2.png',
        'python benchmarks/scan_walk.py BAG --window 40',
        'mapper_node --ros-args --params-file config/kaist.yaml -p graph.lag:=5.0',
        'ros2 run incremental_mapper mapper_node --ros-args -p mom.radius:=1.0',
        'ros2 service call /incremental_mapper/save_map std_srvs/srv/Trigger',
        'ROS_DOMAIN_ID=7 incremental_mapper play bag --rate 2 --loop',
    ],
)
def test_right_commands_pass(line: str) -> None:
    assert mistakes(shell(line)) == []


@pytest.mark.parametrize(
    ('line', 'told'),
    [
        ('incremental_mapper mapp my_bag out', 'invalid choice'),
        ('incremental_mapper map my_bag out --confg config/kaist.yaml', 'unrecognized arguments'),
        ('incremental_mapper evaluate my_bag', 'the following arguments are required'),
        ('incremental_mapper map my_bag out --strategy best', 'is none of mom'),
        ('incremental_mapper map my_bag out --config config/kaits.yaml', 'does not exist'),
        ('incremental_mapper evaluate a --out b --strategies base,best', "'best' is no strategy"),
        ('incremental_mapper plot map out --from 3', 'unrecognized arguments'),
        ('incremental_mapper play bag --rate fast', 'is no number'),
        ('make demonstration', "no target 'demonstration'"),
        ('make demo DEMO_MINUTES=5', 'no variable DEMO_MINUTES'),
        ("pip install '.[reports]'", "no extra 'reports'"),
        ('python examples/figure3.py out.png', 'examples/figure3.py does not exist'),
        ('python benchmarks/scan_walk.py BAG --windows 40', 'no option --windows'),
        ('python -m incremental_mapper.clip', 'no module'),
        ('mapper_node --ros-args --params-file config/kaits.yaml', 'does not exist'),
        ('mapper_node --ros-args --param-file config/kaist.yaml', 'no option'),
        ('mapper_node --ros-args -p graph.lagg:=5.0', 'graph.lagg is no setting'),
        ('mapper_node --ros-args -p graph.lag:=-1.0', 'greater than or equal to 0'),
        ('ros2 service call /incremental_mapper/save std_srvs/srv/Trigger', "no service 'save'"),
        ('ros2 run incremental_mapper node', 'expected incremental_mapper mapper_node'),
        ('incremental-mapper map my_bag out', 'is no program'),
    ],
)
def test_wrong_commands_are_told(line: str, told: str) -> None:
    found = mistakes(shell('make demo', line))
    assert len(found) == 1
    assert told in found[0]
    assert found[0].startswith('3: ')


def test_continued_and_chained_commands_are_one_and_several() -> None:
    text = shell(
        'incremental_mapper evaluate a --out b \\',
        '    --stratgies base',
        'make test; make nothing | make demo && make naught',
    )
    found = mistakes(text)
    assert [item.partition(':')[0] for item in found] == ['2', '4', '4']


def test_transcripts_are_checked_behind_their_prompt_only() -> None:
    text = '```text\n$ incremental_mapper inspect out 50 --as json\nmake nothing\n```'
    assert len(mistakes(text)) == 1
    assert 'unrecognized arguments' in mistakes(text)[0]


@pytest.mark.parametrize(
    ('yaml', 'told'),
    [
        ('graph:\n  lag: 3.0', None),
        ('/**:\n  ros__parameters:\n    window: {duration: 0.2}', None),
        ('lidars:\n  names: [a]\n  a: {T_base_sensor: [0, 0, 0, 0, 0, 0, 1]}', None),
        ('graph:\n  lagg: 3.0', 'graph.lagg is no setting'),
        ('graph:\n  lag: 3000.0', 'less than or equal to 60'),
        ('/**:\n  ros__parameters:\n    windows: {duration: 0.2}', 'windows is no setting'),
        ('lidars:\n  names: [a]\n  a: {T_base_sensor: [0, 0, 0, 0, 0, 0, 2]}', 'norm 2'),
        ('graph: [', 'is no YAML'),
    ],
)
def test_settings_are_held_against_the_schema(yaml: str, told: str | None) -> None:
    found = mistakes(f'```yaml\n{yaml}\n```')
    assert (found == []) if told is None else (len(found) == 1 and told in found[0])


@pytest.mark.parametrize(
    ('code', 'told'),
    [
        ('from pathlib import Path\n\nprint(Path())', None),
        ('from incremental_mapper.measurements import LidarScan, GnssFix', None),
        ('from incremental_mapper.measurements import LidarScans', 'cannot import LidarScans'),
        ('import incremental_mapper.measurement', 'cannot import'),
        ('def f(:\n    pass', 'no Python'),
    ],
)
def test_python_compiles_and_its_imports_are_there(code: str, told: str | None) -> None:
    found = mistakes(f'```python\n{code}\n```')
    assert (found == []) if told is None else (len(found) == 1 and told in found[0])


def test_entry_points_name_the_group_that_is_asked_for() -> None:
    right = '```toml\n[project.entry-points."incremental_mapper.strategies"]\na = "b:c"\n```'
    assert mistakes(right) == []
    assert 'incremental_mapper.strategy' in mistakes(right.replace('strategies', 'strategy'))[0]


@pytest.mark.parametrize(
    ('span', 'told'),
    [
        ('graph.lag', None),
        ('graph.markers_*', None),
        ('map.png', None),
        ('map.store: disk', None),
        ('lidars.left.topic', None),
        ('lidars.names', None),
        ('candidates/partitions.py', None),
        ('config/kaist.yaml', None),
        ('make demo', None),
        ('incremental_mapper play', None),
        ('test/candidates/', None),
        ('out/map.png', None),
        ('graph.lagg', 'graph.lagg is no setting'),
        ('imu.topics', 'imu.topics is no setting'),
        ('map.store: tape', "map.store is 'tape'"),
        ('lidars.left.topics', 'lidars.left.topics is no setting'),
        ('candidates/partition.py', 'candidates/partition.py does not exist'),
        ('examples/no_criterion/', 'examples/no_criterion/ does not exist'),
        ('make demos', "no target 'demos'"),
        ('incremental_mapper plot maps out', 'invalid choice'),
        ('python examples/figure3.py', 'does not exist'),
    ],
)
def test_code_within_sentences_is_checked(span: str, told: str | None) -> None:
    found = mistakes(f'Some words,\nthen `{span}` and more.')
    if told is None:
        assert found == []
    else:
        assert len(found) == 1
        assert found[0].startswith('2: ')
        assert told in found[0]


def test_a_block_has_a_language() -> None:
    assert mistakes('```\nmake demo\n```') == [
        '2: a block without a language; write text if it is no code'
    ]


def test_links_between_files_lead_somewhere(tmp_path) -> None:
    page = tmp_path / 'page.md'
    (tmp_path / 'other.md').write_text('there')
    text = (
        'See [it](other.md#place), [web](https://example.org/a), `[no](link.md)`.\n'
        'And [that](another.md), ![picture](picture.png).\n'
    )
    found = check_pages.check_links(text, page)
    assert [(item.line, item.message) for item in found] == [
        (2, 'the link to another.md leads nowhere'),
        (2, 'the link to picture.png leads nowhere'),
    ]


def test_generated_pages_may_be_linked() -> None:
    page = check_pages.ROOT / 'docs' / 'tuning.md'
    assert check_pages.check_links('[lag](configuration.md#graph.lag)', page) == []
    assert check_pages.check_links('[lag](configurations.md#graph.lag)', page) != []


def test_the_page_of_messages_has_every_refusal_and_reason() -> None:
    text = (check_pages.ROOT / 'docs' / 'messages.md').read_text()
    assert said_messages.check_messages(text, 'messages.md') == []
    without = text.replace('is no file; expected a TUM trajectory', '').replace('stamp_leap', '')
    without = without.replace('`sector_clouds`', '')
    told = [item.message for item in said_messages.check_messages(without, 'messages.md')]
    assert len(told) == 3 and "'sector_clouds'" in told[2]
    assert 'is no file; expected a TUM trajectory' in told[0]
    assert "'stamp_leap'" in told[1]


def test_refusals_are_found_in_the_code() -> None:
    fragments = {fragment for _, fragment in said_messages.refusals()}
    assert 'is not empty; name another folder or add --force' in fragments
    assert len(fragments) > 60
    rules = {rule for _, rule in said_messages.finding_rules()}
    assert {'sector_clouds', 'imu_in_deg', 'sensor_mostly_unused', '_misfit'} <= rules
    assert {'late', 'truncated', 'queue_full'} <= {why for _, why in said_messages.drop_reasons()}


@pytest.mark.parametrize(
    ('head', 'told'),
    [
        ('<link rel="stylesheet" href="assets/a.css">', None),
        ('<link rel="canonical" href="https://example.org/">', None),
        ('<a href="https://example.org/">somewhere</a>', None),
        ('<img src="data:image/png;base64,AAAA">', None),
        ('<link rel="stylesheet" href="https://example.org/a.css">', 'https://example.org/a.css'),
        ('<script src="//example.org/a.js"></script>', '//example.org/a.js'),
        ('<img src="https://example.org/a.png">', 'https://example.org/a.png'),
    ],
)
def test_built_pages_fetch_nothing_from_elsewhere(tmp_path, head: str, told: str | None) -> None:
    (tmp_path / 'index.html').write_text(f'<html><head>{head}</head></html>')
    found = [item.message for item in check_pages.check_site(tmp_path)]
    assert found == ([] if told is None else [f'fetches {told}'])


def test_style_sheets_fetch_nothing_from_elsewhere(tmp_path) -> None:
    (tmp_path / 'index.html').write_text('<html></html>')
    (tmp_path / 'a.css').write_text("@font-face {src: url('b.woff')} a {b: url(data:x)}")
    assert check_pages.check_site(tmp_path) == []
    (tmp_path / 'a.css').write_text("@import url('https://example.org/b.css');")
    assert 'https://example.org/b.css' in check_pages.check_site(tmp_path)[0].message


def test_an_empty_site_is_a_mistake(tmp_path) -> None:
    assert 'holds no page' in check_pages.check_site(tmp_path)[0].message


def test_the_program_tells_and_fails(tmp_path, capsys) -> None:
    page = tmp_path / 'page.md'
    page.write_text(shell('make demos'))
    assert check_pages.main([str(page)]) == 1
    captured = capsys.readouterr()
    assert f"{page}:2: the Makefile has no target 'demos'" in captured.err
    assert captured.out == '1 pages, 1 mistakes\n'
    page.write_text(shell('make demo'))
    assert check_pages.main([str(page)]) == 0
