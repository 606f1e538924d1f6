"""What readers are told of a score, who do not know the names in ``windows.csv``."""

SCORE_NAMES = {
    'mom_3': 'MOM on planes of three directions, m²',
    'mom_2': 'MOM on planes of two directions, m²',
    'mom_1': 'MOM on planes of one direction, m²',
    'plane_variance': 'mean variance of all planes, m²',
}
