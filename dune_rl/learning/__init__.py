"""Learning: one learner for each agent group that trains, and evaluation of policies.

Importing this package, or its `settings`, loads neither PyTorch nor TorchRL.
"""
