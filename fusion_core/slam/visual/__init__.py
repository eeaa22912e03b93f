"""Visual SLAM in six degrees of freedom, after ORB-SLAM2 (Mur-Artal & Tardos 2017; Fu 2024 §3)."""
