"""Scenario → IF samples and truth, made without the approximations of the receiver."""
