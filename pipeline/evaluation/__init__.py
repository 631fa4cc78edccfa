"""How well a run did: labels, planted instances, the paper."""
