//! Errors between images: relative MSE, RMSE, bias.
