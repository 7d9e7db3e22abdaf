"""The task: object paths, the common error, the posture of redundant arms."""
