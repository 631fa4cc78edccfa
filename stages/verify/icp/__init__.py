"""The paper's verification: ICP, judged by its residual."""
